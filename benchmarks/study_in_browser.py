"""A whole study through the real pages: simulated participants click and type in headless Chromium; then analysed.

``python benchmarks/study_in_browser.py STUDY.toml RESULTS --participants 20 [--at-once 6] [--kill 20]``. RESULTS is a
folder of the finite elements (its G plays, its field is felt) or a file of G. Stimuli play through the virtual device;
every session is a process of its own (`forearm-fem study run`), killed at random moments ``--kill`` times in all and
started again. Writes results/study.csv: answers, kills, problems (lost, doubled or out of order: none is allowed) and
seconds from the last answer to the report. A run that was stopped goes on where it was. Needs the extras study and
test, and Chromium.
"""

from __future__ import annotations

import argparse
import csv
import random
import re
import shutil
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np


def main() -> None:
    """Run all sessions, then the analysis."""
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("study", type=Path)
    options.add_argument("transfer", type=Path)
    options.add_argument("--participants", type=int, default=20)
    options.add_argument("--at-once", type=int, default=2)
    options.add_argument("--kill", type=int, default=20)
    options.add_argument("--only", type=int, help="answers per session and participant, to try the script")
    chosen = options.parse_args()
    per_person = [
        chosen.kill // chosen.participants + (k < chosen.kill % chosen.participants) for k in range(chosen.participants)
    ]
    felt = what_is_felt(chosen.study, chosen.transfer)
    file = chosen.transfer / "transfer.nc" if chosen.transfer.is_dir() else chosen.transfer
    from forearm_fem.study.run import Prepared

    began = time.perf_counter()
    with ProcessPoolExecutor(chosen.at_once) as pool:
        jobs = [
            pool.submit(person, chosen.study, file, felt, k, per_person[k], chosen.only)
            for k in range(chosen.participants)
        ]
        done = [job.result() for job in jobs]
    problems = [line for found, _, _ in done for line in found]
    answers, kills = sum(count for _, count, _ in done), sum(killed for _, _, killed in done)
    answered = time.perf_counter()
    subprocess.run([sys.executable, "-m", "forearm_fem", "study", "analyse", str(chosen.study)], check=True)
    report = time.perf_counter() - answered
    row = {"participants": chosen.participants, "answers": answers, "kills": kills, "problems": len(problems),
           "at_once": chosen.at_once, "seconds": round(answered - began),
           "seconds_to_report": round(report, 1)}  # fmt: skip
    write_page(row, chosen.study.parent / Prepared.of(chosen.study).folder.name)
    print(row)
    print("\n".join(problems) or "no answer lost, doubled or out of order")
    sys.exit(bool(problems))


def write_page(row, folder: Path) -> None:  # type: ignore[no-untyped-def]
    """results/study.csv, study.md, and the figures that the analysis in ``folder`` made."""
    out = Path(__file__).parent / "results"
    (out / "study.csv").write_text(",".join(row) + "\n" + ",".join(map(str, row.values())) + "\n")
    pictures = {"identification-ellipses": "Figure 8", "confidence-points": "Figure 9"}
    for name in pictures:
        shutil.copy(folder / "analysis" / f"{name}.png", out / f"study-{name}.png")
    tests = []
    for name in ("identification-error", "confidence-points"):
        with (folder / "analysis" / f"{name}-anova.csv").open() as stream:
            tests += [
                f"| {name.replace('-', ', ')} | {e['name']} | {float(e['f']):.2f} | {float(e['gg']):.2f} | "
                f"{float(e['p_gg']):.2g} |"
                for e in csv.DictReader(stream)
            ]
    lines = [
        "# A whole study through the pages\n",
        "Simulated participants answer by keys and clicks in headless Chromium, every stimulus through the virtual "
        "device, while sessions are killed again and again. **Simulated answers, not people's.** "
        "[study.csv](study.csv)\n",
        "| participants | at once | answers | times killed | sessions with answers lost, doubled or out of order | "
        "last answer to report |\n|---|---|---|---|---|---|",
        f"| {row['participants']} | {row['at_once']} | {row['answers']} | {row['kills']} | {row['problems']} | "
        f"{row['seconds_to_report']} s |\n",
        *(f"![{title}](study-{name}.png)\n" for name, title in pictures.items()),
        "| task, measure | effect | F | epsilon | p (Greenhouse-Geisser) |\n|---|---|---|---|---|",
        *tests,
    ]
    (out / "study.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def what_is_felt(study: Path, transfer: Path):  # type: ignore[no-untyped-def]
    """The energies of all stimuli, the same for everyone here."""
    from forearm_fem.study.field import field_for, grid_field
    from forearm_fem.study.percept import Felt

    from forearm_fem.commands.common import transfer_file
    from forearm_fem.io.recognise import read_measured
    from forearm_fem.study.run import Prepared

    prepared, matrix = Prepared.of(study), read_measured(transfer_file(transfer))
    record = prepared.wavelet.record
    field = field_for(transfer) or grid_field(matrix)
    return Felt.of(field, prepared.stimuli(matrix), record.sample_rate, record.n / record.sample_rate)


def person(study: Path, transfer: Path, felt, number: int, kills: int, only: int | None):  # type: ignore[no-untyped-def]
    """All tasks of one simulated participant; what is wrong with what lies on disk afterwards, and answers there."""
    from forearm_fem.study.percept import Percept, SimulatedParticipant
    from playwright.sync_api import sync_playwright

    from forearm_fem.study.order import trials
    from forearm_fem.study.run import Prepared
    from forearm_fem.study.stimuli import transfer_of

    prepared, name, rng = Prepared.of(study), f"{number + 1:02d}", np.random.default_rng([7, number])
    place = study.parent / prepared.study.transfer.replace("{participant}", name)
    place.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(transfer, place)
    matrix = transfer_of(prepared.study, prepared.base, name)
    mind = SimulatedParticipant(Percept().varied(rng), felt, matrix.outputs, rng)
    problems, count, killed = [], 0, 0
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        for task in prepared.study.tasks:
            order = trials(prepared.study, task, name)[:only]
            moments = set(random.Random(number).sample(range(1, len(order)), min(kills, len(order) - 1)))
            earlier = prepared.store().answers(name, task.name)
            planned = len(moments)
            said: list[tuple[str, ...]] = [tuple(r["response"].split()) for r in earlier]
            while len(said) < len(order):
                said += _sitting(browser, study, name, task, order, said, moments, mind)
            rows = prepared.store().answers(name, task.name)
            count, killed = count + len(rows), killed + planned - len(moments)
            kept = [(r["trial"], r["method"], r["target"], r["response"]) for r in rows]
            expected = [(str(t.number), t.method, t.target, " ".join(a)) for t, a in zip(order, said, strict=False)]
            if kept != expected:
                problems.append(f"participant {name}, {task.name}: {len(kept)} answers on disk, {len(expected)} given")
        browser.close()
    return problems, count, killed


def _sitting(browser, study, name, task, order, said, moments, mind):  # type: ignore[no-untyped-def]
    """One process and one page, until the task is done or the process is killed; the answers given in it."""
    command = [sys.executable, "-u", "-m", "forearm_fem", "study", "run", str(study), "--participant", name,
               "--task", task.name, "--consent", "2026-11-24"]  # fmt: skip
    serving = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    address = next(m[1] for line in serving.stdout if (m := re.match(r"participant:\s+(\S+)", line)))
    page, given = browser.new_page(viewport={"width": 900, "height": 700}), []
    page.set_default_timeout(180_000)  # a machine may be busy; a key that is lost would still never count
    page.goto(address)
    try:
        while len(said) + len(given) < len(order):
            trial = order[len(said) + len(given)]
            page.locator(
                "body[data-waiting='answer'], body[data-waiting='start'], body[data-waiting='break']"
            ).wait_for()
            if page.locator("body[data-waiting='answer']").count() == 0:
                page.locator("#go").click()
                page.locator("body[data-waiting='answer']").wait_for()
            answer = (mind.one_point if task.answer == "one point" else lambda *a: mind.several_points(*a))(
                trial.method, trial.target
            )
            answer = (answer,) if isinstance(answer, str) else answer
            ordered = sorted(answer, key=lambda _: random.random())
            for k, point in enumerate(ordered):
                page.keyboard.press(point) if (len(given) + k) % 2 else page.locator(
                    f"#arm g[data-name='{point}']"
                ).click()
            if task.answer != "one point":
                page.locator("#go").click()
            count = len(said) + len(given) + 1
            page.locator(f"body[data-answered='{count}']").wait_for()
            given.append(tuple(ordered))
            if count in moments:
                moments.discard(count)
                time.sleep(random.random() * 0.8)  # anywhere between the answer and the next stimulus
                serving.kill()
                break
    finally:
        page.close()
        serving.kill()
        serving.wait()
    return given


if __name__ == "__main__":
    main()
