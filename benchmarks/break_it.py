"""Five deliberate bugs and the verification rows that catch them: python3 benchmarks/break_it.py"""

from __future__ import annotations

from forearm_fem.verification.mutations import mutation_table, run_mutations

if __name__ == "__main__":
    print(mutation_table(run_mutations()))
