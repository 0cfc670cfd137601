"""Wall time and memory against true error, one curve per method; cost against size; reduced against direct.

``python benchmarks/speed.py [--full] [--only PART] [--out FOLDER] [--threads N]`` writes CSV, PNG and a page of
sentences; it goes on where it was interrupted. Minutes on two cores, longer with ``--full``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from bench import PARTS, run_bench
from forearm_fem.errors import ForearmError


def main() -> None:
    """Run the parts asked for and print the files written."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="larger systems and held-out frequencies, too")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results", help="where CSV and PNG go")
    parser.add_argument("--only", action="append", metavar="PART", help=f"of {', '.join(PARTS)}; default all")
    parser.add_argument("--threads", type=int, default=1, help="of each run; more than one needs an idle machine")
    asked = parser.parse_args()
    try:
        files = run_bench(asked.out, full=asked.full, only=asked.only, count=max(1, asked.threads), progress=_tell)
    except ForearmError as problem:
        parser.exit(2, f"{problem}\n")
    print(*files, sep="\n")


def _tell(stage: str, done: int, total: int) -> None:
    print(f"{stage}: {done} of {total or '?'}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
