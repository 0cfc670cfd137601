"""The process that compiles kernels beside a first run: all that the run will ask for, and only where it is of use."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import forearm_fem
from forearm_fem.engines import fem as fem_engine
from forearm_fem.engines.fem import solve_fem
from forearm_fem.fem.kernels import jit
from forearm_fem.fem.kernels.compiled import compiled
from forearm_fem.fem.linear import pardiso
from forearm_fem.fem.linear.multifrontal.factor import MultifrontalFactor
from forearm_fem.fem.reduction import compile_ahead
from forearm_fem.geometry.build import build_mesh
from forearm_fem.scenario import parse_scenario

# kernels of the assembly, needed before the process is ready; where none is kept they compile what they call
LEFT_TO_THE_RUN = {"scatter"}
AFTER_THE_KERNELS = """
import sys
from numba.core.dispatcher import Dispatcher
from forearm_fem.fem.reduction.compile_ahead import compile_kernels
from forearm_fem.engines.simulation import simulate
from forearm_fem.scenario import load_scenario

def known():
    ours = [m for name, m in list(sys.modules.items()) if name.startswith("forearm_fem.fem.")]
    return {(v.__module__, v.__name__, str(s)) for m in ours for v in vars(m).values()
            if isinstance(v, Dispatcher) for s in v.signatures}

compile_kernels()
before = known()
assert len(before) > 20
solved = simulate(load_scenario(sys.argv[1], overrides=sys.argv[2:])).solved
assert solved.facts.solver == "multifrontal", solved.facts
for module, name, signature in sorted(known() - before):
    print(module.rsplit(".", 1)[1], name, signature)
"""


@pytest.fixture
def started(monkeypatch):
    """Parts of the processes that would have been started, which end at the third look; earlier ones are forgotten."""
    parts = []

    class Process:
        def __init__(self, command, **_):
            assert command[:-1] == [sys.executable, "-m", "forearm_fem.fem.reduction.compile_ahead"]
            parts.append(command[-1])
            self.looks = 0

        def poll(self):
            self.looks += 1
            return None if self.looks < 3 else 0

        def wait(self, timeout=None):
            if timeout is not None:
                raise subprocess.TimeoutExpired("compiling", timeout)

        def terminate(self):
            pass

    remembered = compile_ahead.start_compiling, compile_ahead._start_last
    for one in remembered:
        one.cache_clear()
    monkeypatch.setattr(compile_ahead.subprocess, "Popen", Process)
    yield parts
    for one in remembered:
        one.cache_clear()


@pytest.mark.slow  # compiles all, and solves, in a process of its own: 30 s
def test_a_run_compiles_nothing_that_the_process_beside_left_out(tmp_path):
    # Small, but above the 3,000 unknowns from which the multifrontal solver is taken, on the coarser mesh, too.
    small = [
        "accuracy=0.5", "sweep.f_max=80", "sweep.duration=0.2",
        "mesh.size_grid=0.008", "mesh.size_contact=0.008", "mesh.size_far=0.04", "rendering.wavelet.peak=65",
    ]  # fmt: skip
    pytest.importorskip("pymetis")
    scene = str(Path(__file__).parents[1] / "scenarios" / "quick.toml")
    done = subprocess.run(
        [sys.executable, "-c", AFTER_THE_KERNELS, scene, *small], capture_output=True, text=True,
        env={**os.environ, "FOREARM_FEM_CACHE": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "kernels")},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    missing = [line for line in done.stdout.splitlines() if line.split()[0] not in LEFT_TO_THE_RUN]
    assert not missing


def test_two_are_started_where_nothing_is_kept_and_the_last_when_these_have_ended(started, monkeypatch):
    monkeypatch.setattr(compile_ahead, "are_kept", lambda kernel: False)
    told = []
    compile_ahead.finish_compiling()
    assert not started  # none was, so there is nothing to wait for
    for _ in range(2):
        compile_ahead.start_compiling()
        assert started[:2] == ["factors", "products"]
        compile_ahead.finish_compiling(lambda stage, done, total: told.append((done, total)))
    assert tuple(started) == compile_ahead.PARTS
    assert told == [(0, 2), (0, 2), (1, 2), (1, 2)]


def test_no_third_is_started_for_complex_numbers_that_no_one_needs(started, monkeypatch):
    monkeypatch.setattr(compile_ahead, "are_kept", lambda kernel: False)
    compile_ahead.start_compiling()
    compile_ahead.finish_compiling(complex_ones=False)
    assert started == ["factors", "products"]


@pytest.mark.slow
def test_a_run_waits_after_its_assembly_and_before_it_factorises(monkeypatch):
    class Waited(Exception):
        pass

    def waiting(progress, *, complex_ones):
        raise Waited

    told = []
    monkeypatch.setattr(fem_engine, "finish_compiling", waiting)
    slab = {"shape": "slab", "length": 0.04, "width": 0.04, "depth": 0.02}
    places = {"device": {"contacts": [[0, 0]]}, "grid": {"points": [[0.01, 0]]}, "rendering": {"methods": []}}
    scene = parse_scenario({"accuracy": 0.5, "limb": slab, **places})
    with pytest.raises(Waited):
        solve_fem(scene, build_mesh(scene), np.array([50.0]), progress=lambda *stage: told.append(stage))
    assert told == [("assembly", 0, 1), ("assembly", 1, 1)]


@pytest.mark.slow  # 3 s
def test_a_small_scene_needs_no_complex_kernels(monkeypatch):
    """Where MKL is there: ends held otherwise are solved by PARDISO, to the same numbers."""
    if pardiso.mkl_library() is None:
        pytest.skip("asks for MKL")
    asked, slab = [], {"shape": "slab", "length": 0.05, "width": 0.05, "depth": 0.015}
    places = {"device": {"contacts": [[0, 0]], "cone": {"contact": "pressure"}}, "grid": {"points": [[0.01, 0]]}}
    sizes = {"size_grid": 0.01, "size_contact": 0.006, "size_far": 0.03}
    scene = parse_scenario({"accuracy": 0.5, "limb": slab, **places, "mesh": sizes, "rendering": {"methods": []}})
    second, band = fem_engine.Second(scene, build_mesh(scene), 2.0), np.linspace(60.0, 120.0, 41)
    monkeypatch.setattr(fem_engine, "finish_compiling", lambda progress, *, complex_ones: asked.append(complex_ones))
    solve_fem(scene, second.mesh, band)
    assert asked == [False]
    one = fem_engine.other_ends(second, band)
    with monkeypatch.context() as patch:
        patch.setattr(MultifrontalFactor, "factorise", None)  # would be a TypeError
        other = fem_engine.other_ends(second, band)
    assert np.array_equal(one.values, other.values, equal_nan=True)
    monkeypatch.setattr(fem_engine, "_SMALL", 0)
    ours = fem_engine.other_ends(second, band)
    assert np.allclose(
        np.nan_to_num(ours.values), np.nan_to_num(one.values), rtol=0, atol=1e-6 * np.nanmax(abs(one.values))
    )
    monkeypatch.setattr(fem_engine, "_LARGE", 0)
    solve_fem(scene, second.mesh, band)
    assert asked == [False, True]


def test_it_is_not_started_where_kernels_are_kept_or_cannot_be_compiled(started, monkeypatch):
    monkeypatch.setattr(compile_ahead, "are_kept", lambda kernel: True)
    compile_ahead.start_compiling()
    compile_ahead.start_compiling.cache_clear()
    monkeypatch.setattr(compile_ahead, "compiled", lambda module: None)
    compile_ahead.start_compiling()
    compile_ahead.finish_compiling()
    assert not started


def test_kernels_of_other_sources_do_not_count(tmp_path, monkeypatch):
    """One digit in any file of kernels, also one that only calls the kernel, asks for another folder."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    sources = tmp_path / "kernels", tmp_path / "multifrontal"
    for folder in sources:
        folder.mkdir()
        (folder / "one.py").write_text("FACTOR = 2.0\n")
    monkeypatch.setattr(jit, "_SOURCES", sources)
    folder = jit.kernels_folder.__wrapped__
    first = folder()
    assert first.parent == tmp_path / "kept"
    assert folder() == first
    (sources[1] / "one.py").write_text("FACTOR = 3.0\n")
    assert folder() != first


def test_what_is_compiled_is_kept_for_the_next_process_and_by_signature(tmp_path, monkeypatch):
    monkeypatch.setattr(jit, "kernels_folder", lambda: tmp_path)

    def doubled(x):
        return 2 * x

    first = jit.kernel(doubled)
    assert not compile_ahead.are_kept(first)
    assert first(3) == 6
    assert first(1.5) == 3.0
    assert len(list(tmp_path.iterdir())) == 2
    again = jit.kernel(doubled)
    assert compile_ahead.are_kept(again)
    assert again(3) == 6
    assert sum(again.stats.cache_hits.values()) == 1
    for file in tmp_path.iterdir():
        file.write_bytes(file.read_bytes()[:100])  # cut short by a full disk
    third = jit.kernel(doubled)
    assert third(3) == 6
    assert sum(third.stats.cache_hits.values()) == 0


def test_what_kernels_call_is_kept_within_them(tmp_path, monkeypatch):
    """One file for both, which the next process runs without compiling the inner one."""
    monkeypatch.setattr(jit, "kernels_folder", lambda: tmp_path)
    one_more = jit.inner_kernel(lambda x: x + 1)

    def twice_one_more(x):
        return 2 * one_more(x)

    assert jit.kernel(twice_one_more)(3) == 8
    assert len(list(tmp_path.iterdir())) == 1
    one_more = jit.inner_kernel(lambda x: 1 // 0)  # is not asked for
    again = jit.kernel(twice_one_more)
    assert again(3) == 8
    assert sum(again.stats.cache_hits.values()) == 1


def test_without_a_home_kernels_lie_in_a_private_folder_or_nowhere(tmp_path, monkeypatch):
    (tmp_path / "file").touch()  # root writes everywhere but below a file
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path / "file" / "cache"))
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    folder = jit.kernels_folder.__wrapped__
    there = folder()
    assert there.parent == tmp_path / "temporary"
    assert there.stat().st_mode & 0o077 == 0
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path / "file" / "temporary"))
    assert folder() is None
    monkeypatch.setattr(jit, "kernels_folder", lambda: None)
    compiled = jit.kernel(lambda x: x + 1)
    assert compiled(1) == 2
    assert compile_ahead.are_kept(compiled)  # nothing to gain by a process beside


def test_no_compiled_code_lies_beside_the_sources():
    assert compiled("linear.multifrontal.factor") is not None
    package = Path(forearm_fem.__file__).parent
    assert [*package.rglob("*.nbi"), *package.rglob("*.nbc")] == []
