"""Damaged files of every format, and what reading them comes to: python3 benchmarks/damage.py [COUNT]

COUNT files of each format (60) are damaged in seven ways: a bit flipped, bytes changed, a digit changed, cut, a block
of zeros, blocks swapped, bytes lost. Exits with 1 if a file of ours is changed silently, or worse.
"""

from __future__ import annotations

import collections
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from damage import FORMATS, OUTCOMES, campaign


def main(count: int) -> int:
    """Print the table; the number of outcomes that must not be."""
    print(f"| {count} damaged files each | {' | '.join(OUTCOMES)} |\n|---{'|---' * len(OUTCOMES)}|")
    total: collections.Counter[str] = collections.Counter()
    for form in FORMATS:
        with tempfile.TemporaryDirectory() as folder:
            found = campaign(form, Path(folder), count)
        counted = collections.Counter(what for what, _ in found)
        total += counted
        print(f"| {form.name} | {' | '.join(str(counted[o]) for o in OUTCOMES)} |", flush=True)
        for what, said in found:
            if what not in OUTCOMES[:2]:
                print(f"  {form.name}: {what}: {said}", file=sys.stderr)
    print(f"| all | {' | '.join(str(total[o]) for o in OUTCOMES)} |")
    return sum(total[o] for o in OUTCOMES[2:])


if __name__ == "__main__":
    numbers = [int(a) for a in sys.argv[1:] if a.isdigit()]
    sys.exit(bool(main(numbers[0] if numbers else 60)))
