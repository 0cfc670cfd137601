"""Three workers share two cores: each computes with one thread, unless told otherwise. What asks for PARDISO says so.

Kernels are compiled once, by one worker, while the other runs files that need none; the longest files come first.
"""

import base64
import gc
import hashlib
import os
import pickle
import shutil
import signal
from collections import Counter
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from scenes import once

from forearm_fem.store.folder import default_cache_dir

settings.register_profile("suite", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("suite")  # no test fails by the time that a busy machine takes

# Tests that take a cache of their own still read the kernels that were compiled before.
os.environ.setdefault("NUMBA_CACHE_DIR", str(default_cache_dir() / "kernels"))
if "PYTEST_XDIST_WORKER" in os.environ:
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """How many tests were skipped, by reason: the line that would make them run."""
    told = [report.longrepr for report in terminalreporter.stats.get("skipped", [])]
    reasons = Counter(str(where[2]).removeprefix("Skipped: ") for where in told if isinstance(where, tuple))
    if reasons:
        terminalreporter.section("skipped, by reason")
    for reason, count in reasons.most_common():
        terminalreporter.write_line(f"{count:4d}  {reason}")


@pytest.fixture(scope="session")
def chromium() -> str:
    """Where the browser is."""
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    return found or pytest.skip("no Chromium; `apt-get install chromium` brings it")


@pytest.fixture(scope="module")  # while it lives no other event loop can run
def browser(chromium: str) -> Iterator[Any]:
    """A browser, steered by playwright."""
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        yield running
        running.close()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what is marked ``needs_mkl`` without MKL."""
    from forearm_fem.fem.linear.pardiso import mkl_library

    if item.get_closest_marker("needs_mkl") and mkl_library() is None:
        pytest.skip("MKL is not installed, or off: there is no PARDISO")


# With no kernel kept the first file compiles nearly all of them, in a process of its own: until then the other worker
# has the next ones, on flat layers alone. Long files taken last would leave a worker idle.
FIRST = (
    "test_parametric.py", "test_study_pages.py", "test_cli_borders.py", "test_figures.py", "test_workbench_page.py",
    "test_compile_ahead.py", "test_scenario_keys.py", "test_surface.py", "test_cli_measured.py", "test_two_commands.py",
    "test_strength.py", "test_prediction.py", "test_library.py", "test_fem_reduction.py", "test_design.py",
    "test_geometry_even.py", "test_pipeline.py", "test_workbench.py", "test_workbench_library.py", "test_fem_krylov.py",
    "test_verification.py", "test_validation.py",  # short, but last in the alphabet
)  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files of ``FIRST`` before all others; the order within a file is kept."""
    place = {name: k for k, name in enumerate(FIRST)}
    items.sort(key=lambda item: place.get(item.path.name, len(place)))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is imported stays to the end: going through it for garbage, again and again, took a tenth of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


@pytest.fixture(scope="session")
def integrals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which all workers keep what the layered model's integrals gave, by their arguments."""
    return once(tmp_path_factory, "integrals", lambda folder: None)


@pytest.fixture(scope="module", autouse=True)
def same_integrals_once(request: pytest.FixtureRequest, integrals: Path) -> Iterator[None]:
    """Scenes on the layered model: integrals of the same arguments are computed once a session.

    Not where a file counts them, or interrupts them: ``pytestmark = pytest.mark.integrated``.
    """
    if request.node.get_closest_marker("integrated"):
        yield
        return
    from forearm_fem.engines import layered as layered_engine

    computed = layered_engine.layered_compliance

    def kept(*arguments: Any, progress: object = None, **options: Any) -> Any:
        file = integrals / hashlib.sha256(pickle.dumps((arguments, options))).hexdigest()
        if not file.exists():
            part = file.with_name(f"{file.name}.{os.getpid()}")
            part.write_bytes(pickle.dumps(computed(*arguments, **options)))
            part.replace(file)
        return pickle.loads(file.read_bytes())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(layered_engine, "layered_compliance", kept)
        yield


_DOT = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


@pytest.fixture(scope="module", autouse=True)
def blank_pictures(request: pytest.FixtureRequest) -> Iterator[None]:
    """Figures are made, and kept as a dot instead of laid out and drawn: half the time of whole commands.

    Files that look at pictures say so: ``pytestmark = pytest.mark.drawn``.
    """
    if request.node.get_closest_marker("drawn"):
        yield
        return
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    def dot(self: Figure, place: Any, **_: object) -> None:
        if hasattr(place, "write"):
            place.write(_DOT)
        else:
            Path(place).write_bytes(_DOT)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", dot)
        patch.setattr(Figure, "draw_without_rendering", lambda self: None)
        patch.setattr(ConstrainedLayoutEngine, "execute", lambda self, figure: None)
        yield


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Ctrl-C as it is in a terminal: what a shell starts in the background inherits that it is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
