"""The thesis' two studies through the real pages: simulated participants click and type in headless Chromium.

``python benchmarks/study_in_browser.py STUDY.toml --participants 20 [--at-once 2] [--kill 20]``. The study's G plays
through the virtual device; every session is a process of its own (`forearm-fem study run`), killed (SIGKILL) at random
moments ``--kill`` times in all and started again. In every session the page is reloaded once; every third participant
has a second window open that answers too late; every fourth uses a telephone's width. Then the analysis, and the R
scripts beside it where Rscript is installed: largest differences from our tables. Writes results/study.csv and
study.md. A run that was stopped goes on where it was: participants who are done are in STUDY/browser.jsonl, and
``--seconds`` begins no further one after that time. Needs the extras study and test, and Chromium.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import shutil
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import pandas as pd

from simulated_people import Person

WORSE = {"funneling": 3e-3}  # m of scatter more, so that there is something to find


def main() -> None:
    """Run all sessions, then the analysis, then R."""
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("study", type=Path)
    options.add_argument("--participants", type=int, default=20)
    options.add_argument("--at-once", type=int, default=2)
    options.add_argument("--kill", type=int, default=20)
    options.add_argument("--seconds", type=float, default=1e9, help="after which nobody begins any more")
    chosen = options.parse_args()
    n, began = chosen.participants, time.perf_counter()
    per_person = [chosen.kill // n + (k < chosen.kill % n) for k in range(n)]
    from forearm_fem.study.run import Prepared

    store = Prepared.of(chosen.study).store(begin=True)
    for k in range(n):  # in this order, whoever comes first: the place in the study is the order of enrolment
        store.enrol(f"{k + 1:02d}", consent="2026-11-24", age=20 + k, sex="FM"[k % 2])
    kept = store.folder / "browser.jsonl"
    done = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    left = [k for k in range(n) if k not in {d["number"] for d in done}]
    with ProcessPoolExecutor(chosen.at_once) as pool:
        stop = began + chosen.seconds
        for job in [pool.submit(person, chosen.study, k, per_person[k], stop) for k in left]:
            if (found := job.result()) is not None:
                done.append(found)
                with kept.open("a") as stream:
                    stream.write(json.dumps(found) + "\n")
    if len(done) < n:
        print(f"{len(done)} of {n} are done; the same line goes on")
        return
    began = time.perf_counter()
    subprocess.run([sys.executable, "-m", "forearm_fem", "study", "analyse", str(chosen.study)], check=True)
    problems = [line for d in done for line in d["problems"]]
    row = {
        "participants": n,
        **{k: sum(d[k] for d in done) for k in ("answers", "killed", "reloads", "late_answers_of_second_windows")},
        "problems": len(problems), "seconds_a_participant": round(sum(d["seconds"] for d in done) / n),
        "seconds_to_report": round(time.perf_counter() - began, 1),
    }  # fmt: skip
    write_page(row, store.folder / "analysis")
    print(row)
    print("\n".join(problems) or "no answer lost, doubled or out of order")
    sys.exit(bool(problems))


def write_page(row: dict[str, float], analysis: Path) -> None:
    """results/study.csv, study.md, and the figures that the analysis made."""
    out = Path(__file__).parent / "results"
    (out / "study.csv").write_text(",".join(row) + "\n" + ",".join(map(str, row.values())) + "\n")
    pictures = {"identification-ellipses": "Figure 8", "confidence-points": "Figure 9"}
    for name in pictures:
        shutil.copy(analysis / f"{name}.png", out / f"study-{name}.png")
    tests = []
    for file in sorted(analysis.glob("*-anova.csv")):
        if not file.name.endswith("-r-anova.csv"):
            tests += [
                f"| {file.name.removesuffix('-anova.csv').replace('-', ', ')} | {e.effect} | {e.F:.2f} | {e.df:.2f}, "
                f"{e.df_error:.1f} | {e.p:.2g} |"
                for e in pd.read_csv(file).itertuples()
            ]
    lines = [
        "# A whole study through the pages\n",
        "Simulated participants answer by keys and clicks in headless Chromium, every stimulus through the virtual "
        "device, while sessions are killed, reloaded and opened twice. **Simulated answers, not people's.**\n",
        "| " + " | ".join(k.replace("_", " ") for k in row) + " |\n|" + "---|" * len(row),
        "| " + " | ".join(map(str, row.values())) + " |\n",
        *(f"![{title}](study-{name}.png)\n" for name, title in pictures.items()),
        "| task, measure | effect | F | degrees of freedom | p |\n|---|---|---|---|---|",
        *tests,
        *in_r(analysis),
    ]
    (out / "study.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def in_r(analysis: Path) -> list[str]:
    """The scripts run by R: largest relative difference of each column from ours, over all measures."""
    if shutil.which("Rscript") is None:
        return ["\nR is not installed here, so that its scripts were not run."]
    worst: dict[str, float] = {}
    same = {
        "anova": {"F": "F", "num.Df": "df", "den.Df": "df_error", "Pr..F.": "p", "pes": "partial_eta2",
                  "ges": "generalised_eta2"},
        "mauchly": {"w": "mauchly_w", "p": "mauchly_p"}, "normal": {"W": "W", "p": "p"},
        "pairs": {"estimate": "difference", "low": "low", "high": "high", "t.ratio": "t", "p.corrected": "p"},
    }  # fmt: skip
    for file in sorted(analysis.glob("*.R")):
        subprocess.run(["Rscript", file.name], cwd=analysis, check=True, capture_output=True)
        for kind, columns in same.items():
            theirs = pd.read_csv(analysis / f"{file.stem}-r-{kind}.csv")
            ours = pd.read_csv(analysis / f"{file.stem}-{'anova' if kind == 'mauchly' else kind}.csv")
            theirs.columns = [re.sub(r"[^A-Za-z0-9_]", ".", c) for c in theirs.columns]
            for name, column in columns.items():
                least = 1e-3 * ours[column].abs().max()  # differences of zero are rounding
                apart = (theirs[name] - ours[column]).abs() / ours[column].abs().clip(lower=least)
                key = f"{kind}, {column}"
                worst[key] = max(worst.get(key, 0.0), float(apart.max()))
    rows = [f"| {name} | {value:.1e} |" for name, value in worst.items()]
    return ["\n## The same in R\n", "afex and emmeans, by the scripts that stand beside the report.\n",
            "| table, column | largest relative difference |\n|---|---|", *rows]  # fmt: skip


def person(study: Path, number: int, kills: int, stop: float) -> dict[str, Any] | None:
    """All tasks of one participant: problems, answers on disk, kills, reloads, late answers that were refused.

    None where the time is over before anything was begun.
    """
    from playwright.sync_api import sync_playwright

    from forearm_fem.study.plan import tasks_of, trials
    from forearm_fem.study.run import Prepared

    if (began := time.perf_counter()) > stop:
        return None
    prepared, name = Prepared.of(study), f"{number + 1:02d}"
    store = prepared.store()
    mind = Person(prepared.grid(), number, WORSE)
    problems, count, killed, reloads, refused = list[str](), 0, 0, 0, 0
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        for task in tasks_of(prepared.study, store.place(name)):
            order = trials(prepared.study, task, store.place(name))
            moments = set(random.Random(number).sample(range(1, len(order)), kills))
            planned, kills = len(moments), 0  # in the first task
            said = [tuple(r["response"].split()) for r in store.answers(name, task.name)]
            while len(said) < len(order):
                given, again, late = sitting(browser, study, name, task, order, said, moments, mind, number)
                said, reloads, refused = said + given, reloads + again, refused + late
            rows = store.answers(name, task.name)
            count, killed = count + len(rows), killed + planned - len(moments)
            kept = [(r["trial"], r["method"], r["target"], r["response"]) for r in rows]
            expected = [(str(t.number), t.method, t.target, " ".join(a)) for t, a in zip(order, said, strict=False)]
            if kept != expected:
                problems.append(f"participant {name}, {task.name}: {len(kept)} answers on disk, {len(expected)} given")
        browser.close()
    return {"number": number, "problems": problems, "answers": count, "killed": killed, "reloads": reloads,
            "late_answers_of_second_windows": refused, "seconds": time.perf_counter() - began}  # fmt: skip


def sitting(browser, study, name, task, order, said, moments, mind, number):  # type: ignore[no-untyped-def]
    """One process and its pages, until the task is done or the process is killed; what was answered in it."""
    command = [sys.executable, "-u", "-m", "forearm_fem", "study", "run", str(study), "--participant", name,
               "--task", task.name]  # fmt: skip
    serving = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    address = next(m[1] for line in serving.stdout if (m := re.match(r"participant:\s+(\S+)", line)))
    size = {"width": 360, "height": 640} if number % 4 == 3 else {"width": 900, "height": 700}
    page, given, reloads, late = browser.new_page(viewport=size), list[tuple[str, ...]](), 0, 0
    page.set_default_timeout(180_000)  # a machine may be busy; a key that is lost would still never count
    page.goto(address)
    other = None
    try:
        while len(said) + len(given) < len(order):
            count = len(said) + len(given)
            trial = order[count]
            ready = "body[data-waiting='answer'], body[data-waiting='start'], body[data-waiting='break']"
            page.locator(ready).wait_for()
            if page.locator("body[data-waiting='answer']").count() == 0:
                page.locator("#go").click()
                page.locator("body[data-waiting='answer']").wait_for()
            answer = mind.answer(trial.method, trial.target, several=task.answer == "several points")
            if len(given) == 3:  # in the middle of a trial: the same one waits after it
                page.reload()
                page.locator("body[data-waiting='answer']").wait_for()
                reloads += 1
            for k, point in enumerate(answer):
                if (len(given) + k) % 2:
                    page.keyboard.press(point)
                else:
                    page.locator(f"#arm g[data-name='{point}']").click()
            if task.answer != "one point":
                page.locator("#go").click()
            page.locator(f"body[data-answered='{count + 1}']").wait_for()
            given.append(answer)
            if len(given) == 5 and number % 3 == 0:  # a second window answers the trial that is over
                other = other or browser.new_page()
                other.goto(address)
                where = address.replace("/p/", "/api/") + "/answer"
                reply = other.evaluate(
                    "async ([url, n]) => (await fetch(url, {method: 'POST', headers: {'Content-Type': "
                    "'application/json'}, body: JSON.stringify({points: ['1'], answered: n})})).status", [where, count],
                )  # fmt: skip
                late += reply == 409
                other.close()
            if count + 1 in moments:
                moments.discard(count + 1)
                time.sleep(random.random() * 0.8)  # anywhere between the answer and the next stimulus
                serving.kill()
                break
    finally:
        page.close()
        serving.kill()
        serving.wait()
    return given, reloads, late


if __name__ == "__main__":
    main()
