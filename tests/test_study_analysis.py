"""What is made of answers: errors, ellipses, confusion, tests, the page, and the same in R."""

from __future__ import annotations

import json
import shutil
import subprocess

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from test_study_session import GRID
from typer.testing import CliRunner

from simulated_people import Person

pd = pytest.importorskip("pandas")

from forearm_fem.cli.app import app  # noqa: E402
from forearm_fem.errors import DataError, ScenarioError  # noqa: E402
from forearm_fem.study.analysis import analyse, cells, confusion, ellipses, with_errors  # noqa: E402
from forearm_fem.study.plan import Analysis, Study, Task  # noqa: E402
from forearm_fem.study.report import plot_ellipses, write_analysis  # noqa: E402

pytestmark = pytest.mark.drawn

PLACES = np.array([p.position[:2] for p in GRID])
NAMES = [p.name for p in GRID]


def answers(people=6, repetitions=2, seed=0, methods=("funneling", "inverse filter")):
    """Answers of people who err by 8 mm, by two methods at all targets."""
    rng, rows = np.random.default_rng(seed), []
    for person in range(people):
        for method in methods:
            for k, target in enumerate(NAMES):
                for _ in range(repetitions):
                    x, y = PLACES[k] + rng.normal(scale=8e-3, size=2)
                    near = NAMES[int(np.argmin(np.hypot(*(PLACES - (x, y)).T)))]
                    rows.append({"participant": f"{person:02d}", "phase": "main", "method": method, "target": target,
                                 "response": near, "response_x": x, "response_y": y})  # fmt: skip
    return pd.DataFrame(rows)


def test_errors_are_distances_and_training_is_left_out():
    table = answers()
    table.loc[0, "phase"] = "training"
    main = with_errors(table, GRID)
    assert len(main) == len(table) - 1
    row = main.iloc[5]
    k = NAMES.index(row["target"])
    assert row["error"] == pytest.approx(np.hypot(row["response_x"] - PLACES[k, 0], row["response_y"] - PLACES[k, 1]))
    with pytest.raises(DataError, match="target '12' is no point"):
        with_errors(table.assign(target="12"), GRID)


def test_ellipses_of_all_of_persons_and_within_them():
    """Two people 10 mm apart, each with the same four answers about an own mean: within, only these are left."""
    square = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) * 1e-3
    rows = [(who, xy[0] + away, xy[1]) for who, away in (("a", 0.0), ("b", 10e-3)) for xy in square]
    table = pd.DataFrame(rows, columns=["participant", "response_x", "response_y"]).assign(target="5", method="m")
    found = ellipses(table).set_index("participant")
    assert found["trials"].to_dict() == {"all": 8, "a": 4, "b": 4}
    whole = found.loc["all"]
    assert [whole[f"within_{k}_m2"] for k in ("var_x", "var_y", "cov_xy")] == pytest.approx(
        [8e-6 / 6, 8e-6 / 6, 0.0]
    )  # eight squares of 1 mm, two means
    assert whole["var_x_m2"] == pytest.approx((8e-6 + 8 * 25e-6) / 7)
    assert found.loc["b", ["mean_x_m", "mean_y_m"]].tolist() == pytest.approx([10e-3, 0])
    assert found.loc["a", ["var_x_m2", "var_y_m2", "cov_xy_m2"]].tolist() == pytest.approx([4e-6 / 3, 4e-6 / 3, 0])
    assert np.isnan(ellipses(table[:1])["var_x_m2"]).all()  # one answer has no scatter


def test_figure_8_draws_one_standard_deviation_about_the_mean_answer_across_and_along_the_limb():
    """Scatter of 2 mm along and 1 mm across, about (3, -1) mm of target 5: 2 mm wide, 4 mm high at (-1, 3)."""
    square = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) * [2e-3, 1e-3] * np.sqrt(3 / 4) + [3e-3, -1e-3]
    table = pd.DataFrame(square, columns=["response_x", "response_y"])
    figure = plot_ellipses(ellipses(table.assign(target="5", method="m", participant="a")), GRID)
    FigureCanvasAgg(figure).draw()
    whole, within = figure.axes[0].patches
    assert (whole.width, whole.height) == (pytest.approx(4.0), pytest.approx(2.0))
    assert abs(whole.angle) == pytest.approx(90.0)
    assert whole.center == pytest.approx((-1.0, 3.0))
    assert (within.width, within.height) == (pytest.approx(4.0), pytest.approx(2.0))  # of one person the same


def test_precision_is_the_scatter_about_a_persons_own_mean():
    """It does not see bias: moved answers have another error and the same precision. One answer has none."""
    table = with_errors(answers(repetitions=3), GRID)
    moved = with_errors(answers(repetitions=3).assign(response_x=lambda t: t["response_x"] + 5e-3), GRID)
    one, other = (cells(t, "precision")[0] for t in (table, moved))
    assert one == pytest.approx(other, rel=1e-9)
    own = table[(table["participant"] == "00") & (table["target"] == "1") & (table["method"] == "funneling")]
    xy = own[["response_x", "response_y"]].to_numpy()
    assert one[0, 0, 0] == pytest.approx(np.sqrt(np.sum((xy - xy.mean(axis=0)) ** 2) / 2))
    assert np.isnan(cells(with_errors(answers(repetitions=1), GRID), "precision")[0]).all()


def test_missing_cells_leave_a_participant_out_and_are_said():
    table = with_errors(answers(), GRID)
    lacking = table[~((table["participant"] == "03") & (table["target"] == "5") & (table["method"] == "funneling"))]
    tests = analyse(lacking, "error")
    assert (tests.left_out, len(tests.participants)) == (("03",), 5)
    assert any("03" in note for note in tests.notes)
    assert tests.anova["df_error"][0] / tests.anova["epsilon_gg"][0] == pytest.approx(8 * 4)


def test_the_plan_of_the_study_is_what_is_done_and_stands_on_the_page(tmp_path):
    """Holm or Bonferroni, Greenhouse-Geisser or Huynh-Feldt, and a digest that changes with each."""
    table = answers(people=5, methods=("a", "b", "c")).assign(response_time=1.0, date="2026-11-24")
    main = with_errors(table, GRID)
    main["error"] -= 8e-3 * (main["method"] == "a")
    holm, bonferroni = (analyse(main, "error", Analysis(correction=c)) for c in ("holm", "bonferroni"))
    assert (holm.pairs["p"] <= bonferroni.pairs["p"]).all()
    assert (holm.pairs["p"] < bonferroni.pairs["p"]).any()
    assert (holm.pairs["where"] != "").sum() == 27
    assert len({Analysis().digest, Analysis(correction="bonferroni").digest, Analysis(alpha=0.01).digest}) == 3
    plan = Analysis(sphericity="Huynh-Feldt", correction="bonferroni")
    study = Study(name="s", scenario="x", tasks=(Task(name="t"),), analysis=plan)
    page = write_analysis(study, {"t": table}, GRID, tmp_path).read_text()
    assert f"Plan {plan.digest}, fixed in study.json before the first answer (2026-11-24): Huynh-Feldt" in page
    effect = analyse(with_errors(table, GRID), "error", plan).anova.iloc[0]
    row = pd.read_csv(tmp_path / "analysis" / "t-error-anova.csv").iloc[0]
    assert row["df"] == pytest.approx(effect["epsilon_hf"] * 8)


def test_methods_that_are_not_equally_strong_are_a_warning_first_on_the_page(tmp_path):
    table = answers(people=3, repetitions=1).assign(response_time=1.0)
    table = table[table["target"] == "5"]
    study = Study(name="s", scenario="x", tasks=(Task(name="t"),))
    for apart in (0.5, 3.0):
        level = np.where(table["method"] == "funneling", -20.0 + apart, -20.0)
        page = write_analysis(study, {"t": table.assign(weighted_db=level)}, GRID, tmp_path).read_text()
        assert f"differ by up to {apart:.1f} dB at a target" in page
        assert page.count("Methods are not equally strong") == (
            2 if apart > 1 else 0
        )  # in the answer, and by the levels
    page = write_analysis(study, {"t": table}, GRID, tmp_path).read_text()
    assert "How strong stimuli were is unknown" in page


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("Rscript") is None, reason="needs R with afex and emmeans: apt install r-cran-afex")
@pytest.mark.parametrize("sphericity", ["Greenhouse-Geisser", "Huynh-Feldt"])
def test_r_says_the_same(tmp_path, sphericity):
    """The scripts beside the page, run as they are: F, corrected df and p, effect sizes, differences and intervals."""
    # of 17 people or fewer R tells no epsilon of the interaction's 16 contrasts, and corrects nothing, saying so
    table = answers(people=18, repetitions=3, methods=("a", "b", "c")).assign(response_time=1.0)
    plan = Analysis(sphericity=sphericity, correction="bonferroni" if sphericity == "Huynh-Feldt" else "holm")
    study = Study(name="s", scenario="x", tasks=(Task(name="t"),), analysis=plan)
    folder = write_analysis(study, {"t": table}, GRID, tmp_path).parent
    for measure in ("error", "precision"):
        done = subprocess.run(["Rscript", f"t-{measure}.R"], cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        ours, theirs = (pd.read_csv(folder / f"t-{measure}{k}.csv") for k in ("-anova", "-r-anova"))
        assert theirs["F"].to_numpy() == pytest.approx(ours["F"].to_numpy(), rel=1e-8)
        for name, column in {"num Df": "df", "den Df": "df_error", "Pr(>F)": "p", "pes": "partial_eta2",
                             "ges": "generalised_eta2"}.items():  # fmt: skip
            found = theirs.get(name, theirs.get(name.replace(" ", ".").replace("(>F)", "..F.")))
            assert found.to_numpy() == pytest.approx(ours[column].to_numpy(), rel=1e-7), name
        for kind, column in (("mauchly", "w"), ("mauchly", "p"), ("normal", "W"), ("normal", "p")):
            theirs = pd.read_csv(folder / f"t-{measure}-r-{kind}.csv")
            own = pd.read_csv(folder / f"t-{measure}-{'anova' if kind == 'mauchly' else kind}.csv")
            told = own[f"mauchly_{column}"] if kind == "mauchly" else own[column]
            assert theirs[column].to_numpy() == pytest.approx(told.to_numpy(), rel=1e-7), (kind, column)
        ours, theirs = (pd.read_csv(folder / f"t-{measure}{k}.csv") for k in ("-pairs", "-r-pairs"))
        for name, column in {"estimate": "difference", "low": "low", "high": "high", "t.ratio": "t",
                             "p.corrected": "p"}.items():  # fmt: skip
            assert theirs[name].to_numpy() == pytest.approx(ours[column].to_numpy(), rel=1e-7, abs=1e-12), name


def test_confusion_shares_add_up_and_split_answers_of_several_points():
    table = pd.DataFrame({"method": "m", "target": ["1", "1", "2"], "response": ["1", "1 2", "3"]})
    shares = confusion(table, NAMES, "m")
    assert shares[0, :2].tolist() == [0.75, 0.25]
    assert shares[1, 2] == 1.0
    assert np.isnan(shares[3]).all()


def test_repetitions_are_no_subjects():
    """Twice the repetitions leave the degrees of freedom alone: the thesis counted each as a subject."""
    for repetitions in (1, 4):
        found = analyse(with_errors(answers(repetitions=repetitions), GRID), "error").anova
        assert (found["df_error"] / found["epsilon_gg"]).tolist() == pytest.approx([40.0, 5.0, 40.0])


def test_trials_without_an_answer_are_no_answers_of_no_points(tmp_path):
    """Four trials are silent; of these, and of answers that tell a place alone, no points are known."""
    table = answers(people=3, repetitions=1).assign(response_time=1.0)
    target = table["target"].to_numpy()
    table["response"] = [f"{t} {u}" for t, u in zip(target, np.roll(target, 1), strict=True)]
    silent = table.index[table["target"].eq("4") & table["participant"].ne("02")]
    table.loc[silent, ["response", "response_x", "response_y"]] = np.nan
    main = with_errors(table, GRID)
    assert main["points"].dropna().eq(2).all()
    assert main["inside"].dropna().all()
    assert main["points"].isna().sum() == main["inside"].isna().sum() == len(silent) == 4
    plan = Study(name="s", scenario="x", tasks=(Task(name="t", answer="several points"),))
    page = write_analysis(plan, {"t": table}, GRID, tmp_path).read_text()
    assert "<td>100 %</td>" in page
    assert "<td>2.00</td>" in page
    assert "Of these, 4 have no answer and are in no mean." in page
    assert (tmp_path / "analysis/t-confusion.png").exists()
    placed = table.assign(response=np.nan).dropna(subset=["response_x"])
    page = write_analysis(plan, {"t": placed}, GRID, tmp_path).read_text()
    assert page.count("<td>unknown</td>") >= 4
    assert "<td>0 %</td>" not in page
    assert not list(tmp_path.glob("analysis/*confusion*"))  # nor the one of the answers before


@pytest.mark.parametrize("kept", [{"method": "funneling"}, {"target": "5"}, {"method": "funneling", "target": "5"}])
def test_a_study_of_one_method_or_one_target_is_analysed_as_far_as_it_goes(tmp_path, kept):
    table = answers(people=4, repetitions=3).assign(response_time=1.0)
    for column, value in kept.items():
        table = table[table[column] == value]
    tests = analyse(with_errors(table, GRID), "error")
    assert tests.anova.empty
    assert tests.pairs.empty == ("method" in kept)
    page = write_analysis(Study(name="s", scenario="x", tasks=(Task(name="t"),)), {"t": table}, GRID, tmp_path)
    assert "there is no two-way analysis" in page.read_text()
    assert all(len(f.read_text()) > 1 for f in page.parent.glob("*.csv"))
    assert not list(page.parent.glob("*-anova.csv"))


def test_a_table_without_main_trials_is_a_sentence():
    with pytest.raises(DataError, match="all answers are to training"):
        with_errors(answers().assign(phase="test"), GRID)


def test_cells_put_ten_after_nine():
    table = pd.DataFrame({"participant": ["10", "9"], "target": ["1", "1"], "method": ["a", "a"], "error": [1.0, 2.0]})
    values, people, *_ = cells(table, "error")
    assert people == ["9", "10"]
    assert values[:, 0, 0].tolist() == [2.0, 1.0]


def test_a_new_study_of_no_scenario_leaves_no_file(tmp_path):
    made = CliRunner().invoke(app, ["study", "new", "pilot", "--scenario", "nosuch", "--folder", str(tmp_path)])
    assert isinstance(made.exception, ScenarioError)
    assert "nosuch: no such file" in str(made.exception)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a/b", "../x", "a b", "con", "größe", "-a", "a" * 33, 'a"b'])
def test_a_name_that_names_no_file_is_refused_before_anything_is_written(tmp_path, name):
    made = CliRunner().invoke(app, ["study", "new", "--folder", str(tmp_path), "--", name])
    assert isinstance(made.exception, ScenarioError)
    assert "expected at most 32 letters, digits and hyphens" in str(made.exception)
    assert not list(tmp_path.rglob("*"))


_SCENE = """
name = "flat"
engine = "layered"
[device.cone]
contact = "pressure"
[sweep]
sample_rate = 2000.0
duration = 0.2
"""


def test_a_study_from_nothing_to_its_page_from_the_command_line(tmp_path):
    """solve, new, stimuli, answers of simulated people as jsPsych writes them, analyse, power: no traceback."""
    (tmp_path / "flat.toml").write_text(_SCENE)
    run, file = CliRunner().invoke, tmp_path / "pilot.toml"
    solved = run(app, ["run", "--until", "solve", str(tmp_path / "flat.toml"), "--out", str(tmp_path / "g")])
    assert solved.exit_code == 0, solved.output
    words = ["--scenario", "flat.toml", "--folder", str(tmp_path), "--transfer", str(tmp_path / "g")]
    made = run(app, ["study", "new", "pilot", *words])
    assert made.exit_code == 0, made.output
    assert "as rendered" in made.output
    assert "methods differ by up to 0.0 dB" in made.output
    text = file.read_text().replace('["1", "2", "3", "4", "5", "6", "7", "8", "9"]', '["1", "5", "9"]')
    text = text.replace("calibration/{participant}/transfer.nc", "g/transfer.nc")
    file.write_text(text.replace("training = 1", "training = 0"))
    (tmp_path / "answers").mkdir()
    for k, who in enumerate(("01", "02", "03", "04")):
        done = run(app, ["study", "stimuli", str(file), "--participant", who, "--rate", "8000"])
        assert done.exit_code == 0, done.output
        trials = pd.read_csv(tmp_path / "pilot" / "stimuli" / f"sub-{who}" / "trials.csv", dtype=str)
        person = Person(GRID, k)
        said = [
            {**row, "response": person.answer(row["method"], row["target"], several=row["answer"] != "one point")}
            for row in trials.to_dict("records")
        ]
        (tmp_path / "answers" / f"{who}.json").write_text(json.dumps(said))
    done = run(app, ["study", "analyse", str(file), "--answers", str(tmp_path / "answers")])
    assert done.exit_code == 0, done.output
    out = tmp_path / "pilot" / "analysis"
    for name in ("identification-ellipses", "identification-confusion", "confidence-points"):
        assert (out / f"{name}.png").exists()
    assert {"identification-error.R", "confidence-points.R", "identification-precision-anova.csv"} <= {
        f.name for f in out.iterdir()
    }
    assert "04  confidence: 0 of 27" in run(app, ["study", "status", str(file)]).output
    words = ["study", "power", str(file), "--answers", str(tmp_path / "answers"), "--task"]
    done = run(app, [*words, "confidence"])
    assert "confidence, points, method: the pilot's effect" in done.output
    done = run(app, [*words, "identification", "--least", "0.02"])
    assert "80 % from" in done.output
    refused = run(app, ["study", "power", str(file)])
    assert "nobody has answered yet" in str(refused.exception)
