"""A short film of the workbench's three arms for README and manual: one passage of the wave, frame by frame.

    python benchmarks/workbench_film.py results/thesis docs/pictures/workbench.webp

Frames are set, not recorded, so that a slow machine makes the same film. Says how large it became; 2 MB is the most.
"""

from __future__ import annotations

import argparse
import io
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

WIDTH, FRAMES, MILLISECONDS = 760, 56, 70
FROM, TO = -0.012, 0.030  # [s] of the passage shown
MOST = 2e6


def frames(page: Path, chromium: str) -> list[Image.Image]:
    """Pictures of the stage at instants from ``FROM`` to ``TO``."""
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        tab = browser.new_page(viewport={"width": 1440, "height": 900}, color_scheme="light")
        tab.goto(page.as_uri())
        tab.locator("body[data-ready]").wait_for(state="attached", timeout=120_000)
        stage, found = tab.locator("#stage"), []
        tab.evaluate("workbench.app.playing = false")
        for k in range(FRAMES):
            tab.evaluate(
                "t => { const {arms, experiment} = workbench; arms.scale = 2; arms.time = t; arms.draw(experiment); }",
                FROM + k * (TO - FROM) / (FRAMES - 1),
            )
            picture = Image.open(io.BytesIO(stage.screenshot())).convert("RGB")
            height = round(picture.height * WIDTH / picture.width)
            found.append(picture.resize((WIDTH, height), Image.Resampling.LANCZOS))
        browser.close()
    return found


def main() -> None:
    """Make the film."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", type=Path, help="results folder, or a page")
    parser.add_argument("film", type=Path, help="a .webp")
    asked = parser.parse_args()
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("no Chromium on this machine")
    with tempfile.TemporaryDirectory() as place:
        page = asked.what
        if page.is_dir():
            from forearm_fem.show.workbench import write_workbench

            page = write_workbench(page, Path(place) / "page.html")
        found = frames(page.resolve(), chromium)
    for quality in (70, 55, 40, 25):
        rest = {"append_images": found[1:], "duration": MILLISECONDS, "loop": 0, "quality": quality}
        found[0].save(asked.film, save_all=True, **rest)
        if asked.film.stat().st_size <= MOST:
            break
    print(f"{asked.film}: {asked.film.stat().st_size / 1e6:.2f} MB, {len(found)} frames, quality {quality}")


if __name__ == "__main__":
    main()
