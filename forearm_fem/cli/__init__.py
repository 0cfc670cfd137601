"""Command line: parses, shows progress, prints; all work is done by the library."""

import os

# OpenBLAS's threads spin for 2^26 cycles after each product before they sleep, on cores that others need: under load
# a run took twice its processor seconds. Read when NumPy is first imported, which is after this.
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "16")
