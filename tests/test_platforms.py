"""What is installed where, and that the program does without what is not."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from forearm_fem.fem.linear import factor as factors

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OPTIONAL = ("pymetis", "mkl", "nvmath", "nidaqmx", "pyuff", "nptdms", "imageio", "dask", "distributed")


@pytest.mark.parametrize(
    ("system", "machine", "wanted"),
    [
        ("Linux", "x86_64", {"mkl", "pymetis"}),
        ("Linux", "aarch64", set()),
        ("Darwin", "arm64", {"pymetis"}),
        ("Darwin", "x86_64", {"pymetis"}),  # the last MKL for macOS is of 2023
        ("Windows", "AMD64", {"mkl"}),
    ],
)
def test_native_packages_are_asked_for_where_they_have_wheels(system, machine, wanted):
    here = {"platform_system": system, "platform_machine": machine}
    asked = [Requirement(line) for line in PROJECT["dependencies"]]
    native = {r.name for r in asked if r.name in ("mkl", "pymetis") and r.marker.evaluate(here)}
    assert native == wanted


def test_every_dependency_states_its_lowest_version():
    """.ci/nightly installs exactly these."""
    lines = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["test"]]
    lines = [line for line in lines if not line.startswith("forearm-fem[")]  # our own extras
    assert [line for line in lines if not re.match(r"[\w.-]+(\[[\w,]+\])?>=\d[\d.]*($|;)", line)] == []


def test_every_module_imports_without_the_optional_packages():
    """All that a platform may lack is hidden at once."""
    code = f"""
import importlib, pkgutil, sys
sys.modules.update(dict.fromkeys({OPTIONAL!r}))
import forearm_fem
for module in pkgutil.walk_packages(forearm_fem.__path__, "forearm_fem."):
    if module.name != "forearm_fem.__main__":
        importlib.import_module(module.name)
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-500:]


def test_without_mkl_the_multifrontal_solver_serves_and_superlu_where_double_precision_is_asked(monkeypatch):
    monkeypatch.setattr(factors.pardiso, "mkl_library", lambda: None)
    monkeypatch.setattr(factors.cudss, "available", lambda: False)
    monkeypatch.setattr(factors, "_compiles", lambda: True)
    assert factors.available_backends() == ("multifrontal", "superlu")
    assert factors.choose_backend("auto", 1_000_000) == "multifrontal"
    assert factors.choose_backend("auto", 1_000, single=False) == "superlu"
