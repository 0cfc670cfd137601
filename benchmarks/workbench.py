"""What the workbench's page costs: bytes, seconds to the first picture, frames a second, processors a frame, memory.

    python benchmarks/workbench.py results/quick results/thesis [more folders, pages or libraries]

Opens each page in headless Chromium, which draws without a graphics processor, at 1440 x 900, and lets the waves play.
Frames a second are those of an animation at rest, with nothing else pressed; where other programs keep the machine
busy, milliseconds of processors per frame (all of the browser's processes together) say what an idle one would do: two
cores give 20 frames a second where they stay below 100, and one core where they stay below 50. Writes
benchmarks/results/workbench.csv and prints the table.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil
from playwright.sync_api import sync_playwright

RESULTS = Path(__file__).parent / "results"
SOFTWARE = ["--no-sandbox", "--disable-gpu"]
WARM, WATCHED = 5.0, 8.0  # [s] until the resolution has settled, and of the measurement
COLUMNS = ("page", "MB", "first_s", "ready_s", "fps", "cpu_ms_a_frame", "script_ms_a_frame", "heap_MB", "renderer_MB")


def processors(browser: psutil.Process) -> float:
    """Seconds that the browser and all its children have computed."""
    total = 0.0
    for one in [browser, *browser.children(recursive=True)]:
        try:
            used = one.cpu_times()
        except psutil.Error:
            continue
        total += used.user + used.system
    return total


def measured(page: Path, browser: Any, process: psutil.Process) -> dict[str, Any]:
    """One page, opened and watched while its waves play."""
    tab = browser.new_page(viewport={"width": 1440, "height": 900})
    tab.goto(page.resolve().as_uri())
    tab.locator("body[data-ready]").wait_for(state="attached", timeout=120_000)
    first, ready = (float(tab.evaluate(f"document.body.dataset.{k}")) / 1e3 for k in ("first", "ready"))
    tab.evaluate("workbench.app.playing = true")
    time.sleep(WARM)
    tab.evaluate(
        "() => { const a = workbench.arms, plain = a.move.bind(a); globalThis.spent = 0;"
        " a.move = () => { const t = performance.now(); plain(); globalThis.spent += performance.now() - t; }; }"
    )
    begun, used, frames = time.time(), processors(process), tab.evaluate("(spent = 0, workbench.arms.frames)")
    time.sleep(WATCHED)
    drawn = tab.evaluate("workbench.arms.frames") - frames
    seconds, cpu, script = time.time() - begun, processors(process) - used, tab.evaluate("spent")
    heap = tab.evaluate("performance.memory.usedJSHeapSize") / 1e6
    resident = max(c.memory_info().rss for c in process.children(recursive=True)) / 1e6
    tab.close()
    return {
        "page": page.stem, "MB": page.stat().st_size / 1e6, "first_s": first, "ready_s": ready, "fps": drawn / seconds,
        "cpu_ms_a_frame": 1e3 * cpu / drawn, "script_ms_a_frame": script / drawn, "heap_MB": heap,
        "renderer_MB": resident,
    }  # fmt: skip


def pages(places: list[Path], into: Path) -> list[Path]:
    """The pages themselves, made here for what is a folder or a library."""
    from forearm_fem.show.workbench import write_workbench

    return [p if p.suffix == ".html" else write_workbench(p, into / f"{p.name}.html") for p in places]


def main() -> None:
    """Measure every page, print and keep the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, default=RESULTS / "workbench.csv")
    asked = parser.parse_args()
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("no Chromium on this machine")
    rows = []
    with tempfile.TemporaryDirectory() as place, sync_playwright() as driver:
        for page in pages(asked.pages, Path(place)):
            before = {c.pid for c in psutil.Process().children(recursive=True)}
            browser = driver.chromium.launch(executable_path=chromium, args=SOFTWARE)
            own = [c for c in psutil.Process().children(recursive=True) if c.pid not in before]
            rows.append(measured(page, browser, own[0]))
            browser.close()
            said = [f"{k} {v:.3g}" if isinstance(v, float) else v for k, v in rows[-1].items()]
            print("  ".join(said), flush=True)
    with asked.out.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows({k: f"{v:.3g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)


if __name__ == "__main__":
    main()
