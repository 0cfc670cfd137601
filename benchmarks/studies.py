"""What a study's analysis and its simulated participants are worth: benchmarks/results/studies.md, CSVs and figures.

``python benchmarks/studies.py STUDY.toml RESULTS [--studies 1000]``. RESULTS is a folder of the finite elements for the
study's scenario. Null studies and power are drawn at random with numbers like the thesis'; simulated participants do
both tasks on the skin's field and are held against what the thesis reports. A minute of one core.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
from forearm_fem.study.field import SkinField, grid_field, simulated_field
from forearm_fem.study.percept import Felt, Percept, SimulatedParticipant
from scipy import stats

from forearm_fem.io.netcdf import read_transfer
from forearm_fem.study.anova import repeated_measures
from forearm_fem.study.figures import plot_power
from forearm_fem.study.power import Supposed, power_curve
from forearm_fem.study.run import Prepared

HERE = Path(__file__).parent / "results"
FACTORS = ("location", "method")
EFFECTS = ("location", "method", "location x method")
TRIAL, OWN, CELL = 10e-3, 2e-3, 3e-3  # [m] scatter of a trial, of participants, of their cells: sizes like the thesis'
PEOPLE, REPETITIONS = 20, 3
CORNERS, EDGES = ("1", "3", "7", "9"), ("2", "4", "6", "8")


def main() -> None:
    """All three parts."""
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("study", type=Path)
    options.add_argument("results", type=Path)
    options.add_argument("--studies", type=int, default=1000)
    chosen = options.parse_args()
    HERE.mkdir(exist_ok=True)
    text = ["# Studies\n\nWritten by `python benchmarks/studies.py`; each table from the CSV named below it.\n"]
    text += null_studies(chosen.studies)
    text += power(chosen.studies)
    text += simulated(chosen.study, chosen.results)
    (HERE / "studies.md").write_text("\n".join(text), encoding="utf-8")


def null_studies(count: int) -> list[str]:
    """Share of studies without any effect in which one is found, by four ways of testing."""
    rng = np.random.default_rng(11)
    rows = []
    for name, scale in (("even", np.ones(9)), ("uneven", np.array([0.4, 0.5, 0.6, 2, 2.5, 3, 0.5, 0.4, 3]))):
        hits = {way: np.zeros(3) for way in ("corrected", "Huynh-Feldt", "uncorrected", "repetitions as subjects")}
        for _ in range(count):
            own = OWN * rng.standard_normal((PEOPLE, 1, 1, 1))
            cells = CELL * rng.standard_normal((PEOPLE, 9, 3, 1)) * scale[:, None, None]
            trials = own + cells + TRIAL * rng.standard_normal((PEOPLE, 9, 3, REPETITIONS))
            right = {e.name: e for e in repeated_measures(trials.mean(axis=3), FACTORS)}
            wrong = {e.name: e for e in repeated_measures(_stacked(trials), FACTORS)}
            hits["corrected"] += [right[e].p_gg < 0.05 for e in EFFECTS]
            hits["Huynh-Feldt"] += [right[e].p_hf < 0.05 for e in EFFECTS]
            hits["uncorrected"] += [right[e].p < 0.05 for e in EFFECTS]
            hits["repetitions as subjects"] += [wrong[e].p_gg < 0.05 for e in EFFECTS]
        rows += [[name, way, *(f"{n / count:.3f}" for n in found)] for way, found in hits.items()]
    _write("studies-null.csv", ["scatter", "test", *EFFECTS], rows)
    return [
        f"## False alarms\n\nShare of {count} studies without any effect in which one was found (p < 0.05). Each has "
        f"{PEOPLE} participants and {REPETITIONS} repetitions of every target and method. The right share is 0.05; "
        "chance moves it by 0.014 to either side (two standard deviations). The chosen test is the corrected one "
        "(Greenhouse-Geisser; subjects are participants). In the uneven studies cells scatter up to 7.5 times more at "
        "some targets than at others. "
        "[studies-null.csv](studies-null.csv)\n",
        _table(["scatter", "test", *EFFECTS], rows),
        "",
    ]


def _stacked(trials: np.ndarray) -> np.ndarray:
    """(participants x repetitions, 9, 3): each repetition a subject of its own."""
    return np.moveaxis(trials, 3, 1).reshape(-1, *trials.shape[1:3])


def power(count: int) -> list[str]:
    """Participants that a difference of 2 mm between one method and the others needs."""
    means = np.zeros((9, 3)) + np.array([0.0, 0.0, 2e-3])
    curve = power_curve(Supposed(means, OWN, CELL, TRIAL), (4, 6, 8, 10, 14, 20, 28), REPETITIONS, studies=count)
    plot_power(curve).savefig(HERE / "studies-power.png", dpi=130)
    rows = [[p.participants, f"{p.share:.3f}", f"{p.low:.3f}", f"{p.high:.3f}"] for p in curve]
    _write("studies-power.csv", ["participants", "share", "low", "high"], rows)
    return [
        f"## Power\n\nShare of {count} studies that find one method 2 mm better than the other two, with the scatter "
        "that is supposed here. `forearm-fem study power` does the same from a pilot's answers.\n",
        _table(
            ["scatter of", "mm"],
            [["a trial", f"{1e3 * TRIAL:g}"], ["participants", f"{1e3 * OWN:g}"], ["their cells", f"{1e3 * CELL:g}"]],
        )
        + "\n",
        "![power](studies-power.png)\n",
        _table(["participants", "share found", "95 % from", "to"], rows),
        "",
    ]


def simulated(study: Path, results: Path) -> list[str]:
    """What simulated participants answer, beside what the thesis reports of people."""
    prepared, transfer, field = Prepared.of(study), read_transfer(results / "transfer.nc"), simulated_field(results)
    loose = np.array([0.3 if p.position[0] < 0 else 1.0 for p in transfer.inputs])
    cases = {
        "field": (transfer, field),
        "grid points only": (transfer, grid_field(transfer)),
        "two loose actuators": (
            replace(transfer, values=transfer.values * loose), replace(field, amplitudes=field.amplitudes * loose)
        ),
    }  # fmt: skip
    answered = {name: _answers(prepared, *case) for name, case in cases.items()}
    rows = [[name, *_line(prepared, *found)] for name, found in answered.items()]
    head = ["felt", *(f"error, {m} [mm]" for m in prepared.study.stimuli.methods), "best four targets",
            *(f"points, {m}" for m in prepared.study.stimuli.methods), "corners", "edges"]  # fmt: skip
    _write("studies-simulated.csv", head, rows)
    claims = _claims(prepared, answered)
    return [
        "## Simulated participants and the thesis\n\n**They predict nobody**: nothing was fitted, and what is compared "
        "is one scene. 20 participants answer 81 trials of each task, drawn with a fixed seed. Felt is the skin's "
        "field of the finite elements (under and between the actuators, too), or the grid's nine points alone, or the "
        "field with the two actuators beside the first row of points moving 0.3 times as much, as the thesis suspects "
        "of its device (inverse filter and combination are rendered on that G, funneling does not know).\n",
        _table(head, rows),
        "\n",
        _table(["the thesis reports of people", "simulated on the field", "with two loose actuators"], claims),
        "\n[studies-simulated.csv](studies-simulated.csv)\n",
    ]


def _answers(prepared: Prepared, transfer, field: SkinField) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    """Mean error [m] and mean number of points (participant, target, method)."""
    stimuli, record = prepared.stimuli(transfer), prepared.wavelet.record
    felt = Felt.of(field, stimuli, record.sample_rate, record.n / record.sample_rate)
    places = {p.name: np.array(p.position[:2]) for p in transfer.outputs}
    methods, targets = prepared.study.stimuli.methods, prepared.study.stimuli.targets
    errors, points = np.zeros((2, PEOPLE, len(targets), len(methods)))
    for k in range(PEOPLE):
        rng = np.random.default_rng([0, k])
        person = SimulatedParticipant(Percept().varied(rng), felt, transfer.outputs, rng)
        for i, target in enumerate(targets):
            for j, method in enumerate(methods):
                named = [places[person.one_point(method, target)] for _ in range(REPETITIONS)]
                errors[k, i, j] = np.mean([np.linalg.norm(n - places[target]) for n in named])
                points[k, i, j] = np.mean([len(person.several_points(method, target)) for _ in range(REPETITIONS)])
    return errors, points


def _line(prepared: Prepared, errors: np.ndarray, points: np.ndarray) -> list[str]:
    targets = prepared.study.stimuli.targets
    best = sorted(np.array(targets)[np.argsort(errors.mean(axis=(0, 2)))[:4]])
    at = {name: points[:, [targets.index(t) for t in group]].mean() for name, group in (("c", CORNERS), ("e", EDGES))}
    means = [f"{1e3 * v:.1f}" for v in errors.mean(axis=(0, 1))], [f"{v:.2f}" for v in points.mean(axis=(0, 1))]
    return [*means[0], " ".join(best), *means[1], f"{at['c']:.2f}", f"{at['e']:.2f}"]


def _claims(prepared: Prepared, answered: dict[str, tuple[np.ndarray, np.ndarray]]) -> list[list[str]]:
    """Each claim of the thesis, section V.C, and what holds in the model."""
    methods, targets = list(prepared.study.stimuli.methods), list(prepared.study.stimuli.targets)
    ift, fi = methods.index("inverse filter"), methods.index("funneling")
    columns = [answered["field"], answered["two loose actuators"]]

    def paired(a: np.ndarray, b: np.ndarray, unit: float, name: str) -> str:
        """Mean difference in ``unit``, and the probability of a paired t-test."""
        p = stats.ttest_rel(a, b).pvalue if np.any(a != b) else 1.0
        return f"{unit * (a - b).mean():+.2f} {name}, p {'< 0.001' if p < 1e-3 else f'{p:.3f}'}"

    def best(e: np.ndarray) -> str:
        """The four best and the three worst targets."""
        order = np.array(targets)[np.argsort(e.mean(axis=(0, 2)))]
        return "best " + " ".join(sorted(order[:4])) + ", worst " + " ".join(sorted(order[-3:]))

    def group(x: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
        """Each participant's mean over the targets ``names``."""
        return x[:, [targets.index(t) for t in names]].mean(axis=(1, 2))

    rows = [["best at 4, 5, 7 and 8", *(best(e) for e, _ in columns)]]
    smaller = [paired(e[:, :, ift].mean(axis=1), e[:, :, fi].mean(axis=1), 1e3, "mm") for e, _ in columns]
    rows.append(["error of inverse filter less than of funneling", *smaller])
    for t in ("1", "3", "9"):
        k = targets.index(t)
        rows.append([f"the same at {t}", *(paired(e[:, k, ift], e[:, k, fi], 1e3, "mm") for e, _ in columns)])
    fewer = [paired(n[:, :, ift].mean(axis=1), n[:, :, fi].mean(axis=1), 1, "points") for _, n in columns]
    rows.append(["fewer points with the inverse filter than with funneling", *fewer])
    narrow = [paired(group(n, CORNERS), group(n, EDGES), 1, "points") for _, n in columns]
    rows.append(["fewer points at corners than at edges", *narrow])
    return rows


def _table(head: list[str], rows: list[list[object]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(map(str, r)) + " |" for r in rows])


def _write(name: str, head: list[str], rows: list[list[object]]) -> None:
    with (HERE / name).open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream, lineterminator="\n").writerows([head, *rows])


if __name__ == "__main__":
    main()
