"""Weakly damped bands: true and stated error of the reduced sweep, under settings that round differently.

python benchmarks/resonances.py            # five settings, a process each; writes benchmarks/results/resonances.csv
python benchmarks/resonances.py --setting "one thread"      # this process' own lines
"""

from __future__ import annotations

import argparse
import csv
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from forearm_fem.errors import SolverError
from forearm_fem.fem.reduction.sweep import direct_sweep, reduced_sweep
from forearm_fem.scenario.sweep import ReducedSolve
from forearm_fem.transfer import relative_error
from forearm_fem.verification.scenes import flesh, held_block

RESULT = Path(__file__).parent / "results" / "resonances.csv"
BANDS = ((10.0, 150.0), (10.0, 210.0), (100.0, 200.0))
LOSSES = (0.02, 0.04, 0.1)  # eta [Pa s] of a block of 7860 Pa
STEP = 4.0  # [Hz]
ONE = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "MKL", "NUMBA", "OPENBLAS")}
SETTINGS = {
    "one thread": {},
    "two threads": dict.fromkeys(ONE, "2"),
    "MKL_CBWR=COMPATIBLE": {"MKL_CBWR": "COMPATIBLE"},
    "no AVX-512": {"OPENBLAS_CORETYPE": "Haswell", "NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": "+avx2,+fma"},
    "no MKL": {"FOREARM_FEM_MKL": "off"},
}
NAMES = ("setting", "eta_Pa_s", "from_Hz", "to_Hz", "true", "stated", "derivatives", "columns", "expansions", "seconds")


def lines(setting: str) -> list[dict[str, object]]:
    """One line for each band and loss, against direct solves in double precision in the same process."""
    found: list[dict[str, object]] = []
    for eta in LOSSES:
        model = held_block(2, tissue=flesh(eta=eta, bulk=2.2e9))
        for low, high in BANDS:
            band, start = np.arange(low, high + STEP / 2, STEP), time.perf_counter()
            try:
                swept = reduced_sweep(model, band, ReducedSolve(), tolerance=1e-4)
            except SolverError as problem:
                found.append(dict(zip(NAMES, (setting, eta, low, high, str(problem)), strict=False)))
                continue
            seconds = time.perf_counter() - start
            exact = direct_sweep(model, band, ReducedSolve(precision="double")).values
            error = relative_error(swept.values[:, 1:, :1], exact[:, 1:, :1]).max()
            assert swept.reduced is not None
            numbers = (f"{error:.2g}", f"{swept.reduction_error:.2g}", swept.derivatives, swept.reduced.size)
            line = (setting, eta, low, high, *numbers, len(swept.expansions), f"{seconds:.1f}")
            found.append(dict(zip(NAMES, line, strict=True)))
    return found


def main() -> None:
    """The table of all settings, each in a process of its own, or the lines of one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--setting", choices=SETTINGS)
    chosen = parser.parse_args().setting
    out = csv.DictWriter(sys.stdout, NAMES)
    if chosen:
        out.writerows(lines(chosen))
        return
    with RESULT.open("w") as file:
        file.write(",".join(NAMES) + "\n")
        for name, environment in SETTINGS.items():
            command = [sys.executable, __file__, "--setting", name]
            own = {**os.environ, **ONE, **environment}
            done = subprocess.run(command, env=own, check=True, stdout=subprocess.PIPE, text=True)
            print(done.stdout, end="", flush=True)
            file.write(done.stdout.replace("\r\n", "\n"))


if __name__ == "__main__":
    main()
