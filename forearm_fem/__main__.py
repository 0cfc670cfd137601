"""The command line as a module: ``python -m forearm_fem`` does what ``forearm-fem`` does."""

from __future__ import annotations

from .cli.app import main

if __name__ == "__main__":
    main()
