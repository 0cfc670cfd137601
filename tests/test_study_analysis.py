"""What is made of answers: errors, ellipses, confusion, simulated participants, power, and the thesis' own figures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from test_study_session import GRID
from typer.testing import CliRunner

pd = pytest.importorskip("pandas")
pytest.importorskip("statsmodels")

from forearm_fem.cli import app  # noqa: E402
from forearm_fem.errors import DataError, ScenarioError  # noqa: E402
from forearm_fem.ports import Port  # noqa: E402
from forearm_fem.study.analysis import analyse, cell_means, confusion, ellipses, with_errors  # noqa: E402
from forearm_fem.study.field import SkinField, grid_field  # noqa: E402
from forearm_fem.study.percept import Felt, Percept, SimulatedParticipant, pooled, sensitivity  # noqa: E402
from forearm_fem.study.plan import Study, Task, load_study  # noqa: E402
from forearm_fem.study.power import Supposed, needed, power_curve, supposed_from, untold  # noqa: E402
from forearm_fem.study.report import write_analysis  # noqa: E402
from forearm_fem.study.session import _outline  # noqa: E402
from forearm_fem.study.tables import foreign_table  # noqa: E402
from forearm_fem.study.thesis import verdicts  # noqa: E402
from forearm_fem.transfer import TransferMatrix  # noqa: E402

PLACES = np.array([p.position[:2] for p in GRID])
NAMES = [p.name for p in GRID]


def answers(people=6, repetitions=2, seed=0):
    """Answers of people who err by 8 mm, by two methods at all targets."""
    rng, rows = np.random.default_rng(seed), []
    for person in range(people):
        for method in ("funneling", "inverse filter"):
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


def test_ellipses_recover_mean_and_covariance():
    """9,000 answers about (2, -1) mm with a known covariance: four standard errors of their estimates."""
    rng, n = np.random.default_rng(3), 9000
    true = np.array([[9.0, 4.0], [4.0, 16.0]]) * 1e-6
    xy = rng.multivariate_normal([2e-3, -1e-3], true, size=n)
    table = pd.DataFrame({"target": "5", "method": "m", "response_x": xy[:, 0], "response_y": xy[:, 1]})
    (found,) = ellipses(table)
    assert found.mean == pytest.approx([2e-3, -1e-3], abs=4 * 4e-3 / np.sqrt(n))
    assert found.covariance == pytest.approx(true, abs=4 * 16e-6 * np.sqrt(2 / n))


def test_confusion_shares_add_up_and_split_answers_of_several_points():
    table = pd.DataFrame({"method": "m", "target": ["1", "1", "2"], "response": ["1", "1 2", "3"]})
    shares = confusion(table, NAMES, "m")
    assert shares[0, :2].tolist() == [0.75, 0.25]
    assert shares[1, 2] == 1.0
    assert np.isnan(shares[3]).all()


def test_missing_cells_leave_a_participant_to_the_mixed_model():
    table = with_errors(answers(), GRID)
    lacking = table[~((table["participant"] == "03") & (table["target"] == "5") & (table["method"] == "funneling"))]
    tests = analyse(lacking, "error")
    assert tests.left_out == ("03",)
    assert len(tests.participants) == 5
    assert any("03" in note for note in tests.notes)
    assert tests.mixed is not None
    assert tests.effects[0].df_error == 8 * 4


def test_repetitions_are_no_subjects():
    """Twice the repetitions leave the degrees of freedom alone: the thesis counted each as a subject."""
    few, many = (analyse(with_errors(answers(repetitions=r), GRID), "error", mixed=False) for r in (1, 4))
    assert [e.df_error for e in few.effects] == [e.df_error for e in many.effects] == [40.0, 5.0, 40.0]


def test_the_thesis_counted_sixty_subjects():
    """All six tests fit 60 rows (20 participants x 3 repetitions) and none fits 20; probabilities follow from F."""
    found = verdicts()
    assert [v.subjects for v in found] == [60] * 6
    assert all(0.7 < v.epsilon <= 1 for v in found)
    assert all(abs(v.p - v.claim.p) < 2e-3 for v in found)


def test_sensitivity_follows_verrillo():
    """-12 dB per octave below 220 Hz, +9 above, of the threshold: displacement counts by the reciprocal. The other
    channel is flat and meets it at the crossing."""
    level = 20 * np.log10(sensitivity(np.array([55.0, 110.0, 220.0, 440.0]), 110.0))
    assert level[0] == pytest.approx([-24.0, -12.0, 0.0, -9.0], abs=1e-9)
    assert level[1] == pytest.approx([-12.0] * 4, abs=1e-9)


def line_field(places, area=None):
    """Places that move with one actuator each, 1 m/V at all frequencies."""
    n = len(places)
    f = np.arange(1.0, 500.0)
    gains = np.broadcast_to(np.eye(n, dtype=complex), (len(f), n, n))
    return SkinField(places, np.ones(n) if area is None else area, f, np.eye(n), gains, whole=True)


def test_energy_of_a_tone_is_its_weighted_square_over_time():
    """One second of 220 Hz and one of 110 Hz, 1 um: by Parseval as by hand; the fade-free ends leak 0.1 %."""
    t = np.arange(1000) / 1000
    tones = 1e-6 * np.sin(2 * np.pi * np.array([[220.0], [110.0]]) * t)
    found = line_field(PLACES[:2]).energy(tones, 1000.0, 1.0, lambda f: sensitivity(f, 110.0))
    assert found[0] == pytest.approx(0.5e-12 * np.array([1.0, 10**-1.2]), rel=1e-6)
    assert found[1] == pytest.approx(0.5e-12 * 10**-1.2 * np.ones(2), rel=1e-6)


def test_a_field_by_modes_is_the_field_by_places():
    """G on the grid through grid_field, against the same motion in time, summed."""
    rng = np.random.default_rng(0)
    f = np.arange(1.0, 100.0)
    values = rng.normal(size=(99, 9, 4)) + 1j * rng.normal(size=(99, 9, 4))
    inputs = tuple(Port(f"A{k}", "contact", (0.02, 0.0, 0.0), radius=1e-3) for k in range(4))
    field = grid_field(TransferMatrix(f, values, GRID, inputs))
    drives = rng.normal(size=(4, 150))
    full = np.zeros((9, 101), dtype=complex)
    full[:, 1:100] = np.einsum("foi,if->of", values, np.fft.rfft(drives, 200, axis=1)[:, 1:100])
    motion = np.fft.irfft(full, 200, axis=1)
    (found,) = field.energy(drives, 200.0, 1.0, lambda f: np.ones((1, len(f))))
    assert found == pytest.approx(np.sum(motion**2, axis=1) / 200, rel=1e-9)


def test_pooling_keeps_a_uniform_field_and_spreads_a_peak():
    assert pooled(np.full(9, 2.0), PLACES, np.ones(9), 5e-3) == pytest.approx(np.full(9, 2.0))
    peak = pooled(np.eye(9)[4], PLACES, np.ones(9), 5e-3)
    assert np.argmax(peak) == 4
    assert 0 < peak[0] < peak[1] < peak[4]


def test_summation_does_not_depend_on_the_mesh():
    """A place cut into three of a third of its area each gives the same sum at the others."""
    energy, area = np.arange(1.0, 10.0), np.ones(9)
    whole = pooled(energy, PLACES, area, 7e-3)
    cut = pooled(
        np.append(energy, [9.0, 9.0]),
        np.vstack([PLACES, PLACES[8], PLACES[8]]),
        np.array([*[1.0] * 8, *[1 / 3] * 3]),
        7e-3,
    )
    assert cut[:9] == pytest.approx(whole, rel=1e-12)


def test_thresholds_fall_by_3_db_per_doubling_of_area_in_one_channel_only():
    """Spots of 10 to 80 mm2 moving alike on a 1 mm grid: pooled energy goes with area while that is well below the
    pooling's 308 mm2 (the largest spot loses 0.5 dB); without pooling nothing changes."""
    x = 1e-3 * np.arange(-22, 23)
    places = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    away = np.argsort(np.hypot(*places.T), kind="stable")
    levels = []
    for area in (10, 20, 40, 80):
        energy = np.zeros(len(places))
        energy[away[:area]] = 1.0
        levels.append(10 * np.log10(pooled(energy, places, np.ones(len(places)), 7e-3).max()))
    assert np.diff(levels) == pytest.approx([3.0, 3.0, 3.0], abs=0.4)


def responder(strength, **percept):
    """A participant of nine places whose energies in the flat channel are ``strength`` (9,)."""
    felt = Felt(PLACES, np.ones(9), {("m", "5"): np.array([np.zeros(9), strength])})
    options = {"blur": 1e-6, "lapse": 0.0, "pooling": 1e-4, **percept}
    return SimulatedParticipant(Percept(**options), felt, GRID, np.random.default_rng(0))


def test_limits_of_the_simulated_participant():
    """Without blur and lapses a spot at one point is felt there; with lapses alone answers spread over the grid;
    with no motion at all nothing is detected, with much everything."""
    sure = responder(1e-13 * np.eye(9)[7])
    assert {sure.one_point("m", "5") for _ in range(20)} == {"8"}
    assert sure.several_points("m", "5") == ("8",)
    lost = responder(1e-13 * np.eye(9)[7], lapse=1.0)
    assert len({lost.one_point("m", "5") for _ in range(300)}) == 9
    assert not any(sure.detects("m", "5", -300.0) for _ in range(50))
    assert all(sure.detects("m", "5", 200.0) for _ in range(50))


def test_two_places_alike_are_felt_between_and_named_both():
    """The funneling illusion as a limit: equal energies at 4 and 6 are felt at 5; where several may, both are named."""
    both = responder(1e-13 * (np.eye(9)[3] + np.eye(9)[5]))
    assert both.one_point("m", "5") == "5"
    assert set(both.several_points("m", "5")) == {"4", "6"}
    wide = responder(np.full(9, 1e-13), blur=3e-3)
    narrow = responder(1e-13 * np.eye(9)[4], blur=3e-3)
    area = [abs(_outline(p.outline("m", "5"))[1]) for p in (narrow, wide)]
    assert area[1] > 10 * area[0]


def test_a_touch_on_a_point_names_it_alone():
    """What ``doubt`` was chosen for: on a grid of 13.3 mm, without the shift of a trial."""
    places = 1.33 * PLACES
    grid = tuple(Port(p.name, "point", (*xy, 0.0)) for p, xy in zip(GRID, places, strict=True))
    felt = Felt(places, np.ones(9), {("m", "5"): np.array([np.zeros(9), np.eye(9)[4]])})
    person = SimulatedParticipant(Percept(lapse=0.0), felt, grid, np.random.default_rng(0))
    person._shift = lambda: np.zeros(2)  # type: ignore[method-assign]
    assert person.several_points("m", "5") == ("5",)


def test_a_blurrier_participant_errs_more():
    means = []
    for blur in (2e-3, 8e-3, 20e-3):
        person = responder(np.eye(9)[4], blur=blur)
        means.append(np.mean([np.hypot(*(person.place("m", "5") - PLACES[4])) for _ in range(400)]))
    # Rayleigh: blur sqrt(pi / 2), standard error of 400 draws 2.6 %
    assert means == pytest.approx(np.array([2e-3, 8e-3, 20e-3]) * np.sqrt(np.pi / 2), rel=0.11)


def test_power_is_the_level_without_an_effect_and_one_with_a_large_one():
    """Without an effect 5 % of 300 studies (2.6 sd: 1.7 to 8.3 %); an effect of three standard errors is found."""
    flat = Supposed(np.zeros((9, 3)), 2e-3, 1e-3, 6e-3)
    (none,) = power_curve(flat, [12], 3, studies=300)
    assert 0.017 <= none.share <= 0.083
    strong = Supposed(flat.means + np.array([0, 2e-3, 4e-3]), 2e-3, 1e-3, 6e-3)
    (found,) = power_curve(strong, [12], 3, studies=100)
    assert found.share > 0.95
    curve = power_curve(Supposed(flat.means + np.array([0, 0, 1e-3]), 2e-3, 1e-3, 6e-3), [4, 12, 40], 3, studies=100)
    assert curve[0].share < curve[1].share < curve[2].share
    assert needed(curve) == 40


def test_a_pilot_gives_back_what_it_was_drawn_from():
    """200 participants of known scatter: standard deviations within 15 %, as estimates from so many are."""
    rng = np.random.default_rng(1)
    true = Supposed(rng.normal(scale=2e-3, size=(9, 3)), 2e-3, 3e-3, 6e-3)
    values = true.means + 2e-3 * rng.standard_normal((200, 1, 1))
    values = values + np.hypot(3e-3, 6e-3 / np.sqrt(3)) * rng.standard_normal(values.shape)
    found = supposed_from(values, 3, 6e-3)
    assert found.between == pytest.approx(2e-3, rel=0.15)
    assert found.cell == pytest.approx(3e-3, rel=0.15)


def test_methods_that_suit_people_differently_need_more_of_them():
    """200 participants, to whom methods differ by 3 mm and targets by 2 mm each way: both are found within 15 %, and
    the power that follows is that of the noncentral F of the method's own error (3 sd of 400 studies: 7.5 %). Cells
    that scattered alike would make it 0.98."""
    rng = np.random.default_rng(4)
    means = np.full((9, 3), 1e-2) + 2e-3 * np.array([1.0, 0.0, -1.0])
    people = means + 2e-3 * rng.standard_normal((200, 1, 1)) + 3e-3 * rng.standard_normal((200, 1, 3))
    people = people + 2e-3 * rng.standard_normal((200, 9, 1))
    found = supposed_from(people + np.hypot(3e-3, 6e-3 / np.sqrt(3)) * rng.standard_normal((200, 9, 3)), 3, 6e-3)
    sizes = [found.method, found.location, found.cell, found.between]
    assert sizes == pytest.approx([3e-3, 2e-3, 3e-3, 2e-3], rel=0.15)
    true = Supposed(means, 2e-3, 3e-3, 6e-3, location=2e-3, method=3e-3)
    (share,) = (p.share for p in power_curve(true, [8], 3, studies=400))
    error = 9 * 3e-3**2 + 3e-3**2 + 6e-3**2 / 3
    squares = 8 * 9 * 2 * 2e-3**2
    expected = stats.ncf.sf(stats.f.isf(0.05, 2, 14), 2, 14, squares / error)
    assert share == pytest.approx(expected, abs=0.075)
    assert expected < 0.6


def test_chance_in_a_pilot_is_not_taken_for_an_effect():
    """400 pilots of four people: the effect supposed is on average as large as the true one (its square within 15 %,
    four standard errors), and without one more than half of the pilots suppose none. Cell means as they are hold a
    variance / 4 of scatter more for each degree of freedom, here as much as the effect itself."""
    rng, sizes = np.random.default_rng(2), []
    for effect in (0.0, 2.5e-3):
        means = np.full((9, 3), 1e-2) + effect * np.array([1.0, 0.0, -1.0])
        found = []
        for _ in range(400):
            pilot = means + 3e-3 * rng.standard_normal((4, 1, 1)) + 6e-3 * rng.standard_normal((4, 9, 3))
            supposed = supposed_from(pilot, 3, 1e-3).means
            found.append(float(np.sum((supposed.mean(axis=0) - supposed.mean()) ** 2)))
        sizes.append(np.array(found))
    assert np.median(sizes[0]) < 1e-30  # rounding of what is none
    assert sizes[1].mean() == pytest.approx(2 * 2.5e-3**2, rel=0.15)


def test_a_pilots_incomplete_participants_are_left_out_and_its_doubt_is_said():
    rng = np.random.default_rng(3)
    pilot = 1e-2 + 5e-3 * rng.standard_normal((5, 9, 3))
    assert "4 participants do not tell this effect from chance" in untold(np.r_[pilot[:4], [np.full((9, 3), np.nan)]],
                                                                        "method")  # fmt: skip
    assert untold(pilot + np.array([0.0, 0.0, 0.1]), "method") == ""
    assert untold(pilot + np.array([0.0, 0.0, 0.1]), "pairs") == ""
    gap = pilot.copy()
    gap[2, 3, 1] = np.nan
    assert np.array_equal(supposed_from(gap, 3, 1e-3).means, supposed_from(np.delete(pilot, 2, axis=0), 3, 1e-3).means)
    with pytest.raises(DataError, match="two participants who answered every cell, got 1"):
        supposed_from(pilot[:1], 3, 1e-3)


def test_other_peoples_tables_are_read_by_a_declared_mapping(tmp_path):
    file = tmp_path / "theirs.csv"
    file.write_text("who,condition,goal,said\nanna,ift,1,1 2\nben,ift,2,\n")
    mapping = ["participant=who", "method=condition", "target=goal", "response=said"]
    table = foreign_table(file, mapping, GRID)
    assert table["response_y"][0] == pytest.approx(-0.005)
    assert np.isnan(table["response_x"][1])
    with pytest.raises(DataError, match="no column is called 'participant'"):
        foreign_table(file, mapping[1:], GRID)
    with pytest.raises(DataError, match="expected ours=theirs"):
        foreign_table(file, ["method=nothing"], GRID)
    file.write_text("who,condition,goal,said\nanna,ift,1,77\n")
    with pytest.raises(DataError, match="line 2: '77' is no grid point"):
        foreign_table(file, mapping, GRID)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "holds no answers"),
        ("participant,method,target,response\n", "holds no answers"),
        ("participant,method,target,response\nanna,a,1,1,5\n", "line 2: 5 cells, the header has 4"),
        ("participant,method,target,response\nanna,a,1\n", "line 2: 3 cells, the header has 4"),
        ("participant,method,target,response\n,a,1,1\n", "line 2: participant is blank"),
        ("participant,method,target,response\n\nanna,a,1,1\n\n,a,1,1\n", "line 5: participant is blank"),
        ("\nparticipant;method;target;response\n;;;\nanna;a;1;77\n", "line 4: '77' is no grid point"),
        ('participant,method,target,response,x\nanna,a,1,1,"two\nlines"\nanna,a,1,77,\n', "line 4: '77' is no grid"),
        ("participant,method,target,response,response\nanna,a,1,1,2\n", "two columns are called 'response'"),
        ("participant,method,target,response_x,response_y\nanna,a,1,13.3,0\n", "reach 13.3 m; are they millimetres"),
    ],
)
def test_tables_that_are_none_or_say_something_else_are_one_sentence(tmp_path, text, said):
    """pandas took a cell too many for the rows' names, and moved all columns by one."""
    file = tmp_path / "theirs.csv"
    file.write_text(text)
    with pytest.raises(DataError, match=said):
        foreign_table(file, [], GRID)


def test_blanks_and_commas_at_the_ends_of_lines_are_none_of_an_answer(tmp_path):
    file = tmp_path / "theirs.csv"
    file.write_text("participant, method ,target,response\nanna , a,1,1 2,\n\n", encoding="utf-8-sig")
    table = foreign_table(file, [], GRID)
    assert table[["participant", "method", "response"]].to_numpy().tolist() == [["anna", "a", "1 2"]]
    file.write_text("participant,method,target,goal,response\nanna,a,1,2,1\n")
    with pytest.raises(DataError, match="two columns are called 'target'"):
        foreign_table(file, ["target=goal"], GRID)


def test_numbers_of_a_spreadsheet_and_its_semicolons_are_read(tmp_path):
    file = tmp_path / "theirs.csv"
    file.write_text("participant;method;target;response\nanna;a;1.0;1.0 2\nben;a;02;\n")
    table = foreign_table(file, [], GRID)
    assert table["target"].tolist() == ["1", "2"]
    assert table["response"][0] == "1 2"
    file.write_text("participant;method;target;response\nanna;a;1.5;1\n")
    with pytest.raises(DataError, match=r"target '1\.5' is no point"):
        with_errors(foreign_table(file, [], GRID), GRID)


def test_a_table_of_others_leaves_the_studys_own_analysis_alone(tmp_path):
    """Its page and tables took the place of the study's, in the study's own folder."""
    for package in ("questplus", "starlette", "uvicorn"):
        pytest.importorskip(package)
    (tmp_path / "pilot.toml").write_text('name = "pilot"\nscenario = "thesis"\n')
    table = answers(people=3, repetitions=1).assign(late=0, response_time=1.0)
    table["response"] = table["target"]
    table[["participant", "method", "target", "response"]].to_csv(tmp_path / "theirs.csv", index=False)
    own = tmp_path / "pilot" / "analysis" / "report.html"
    own.parent.mkdir(parents=True)
    own.write_text("ours")
    said = ["study", "analyse", str(tmp_path / "pilot.toml"), "--table", str(tmp_path / "theirs.csv")]
    done = CliRunner().invoke(app, said)
    assert done.exit_code == 0, done.output
    assert (tmp_path / "pilot-theirs" / "analysis" / "report.html").is_file()
    assert own.read_text() == "ours"
    (tmp_path / "pilot" / "participants.tsv").write_text(
        "participant_id\tconsent\tstatus\tadded\tnote\nsub-01\t2026-11-24\tactive\t2026-11-24\tn/a\n"
    )
    study = load_study(tmp_path / "pilot.toml")
    (tmp_path / "pilot" / "study.json").write_text(study.model_dump_json())
    refused = CliRunner().invoke(app, [*said, "--data", str(tmp_path / "pilot")])
    assert isinstance(refused.exception, DataError)
    assert "holds answers of its own" in str(refused.exception)
    assert own.read_text() == "ours"
    idle = CliRunner().invoke(app, ["study", "analyse", str(tmp_path / "pilot.toml"), "--column", "method=a"])
    assert "has no effect without --table" in str(idle.exception)


def test_trials_without_an_answer_are_no_answers_of_no_points(tmp_path):
    """Four trials are silent; of these, and of answers that tell a place alone, no points are known."""
    table = answers(people=3, repetitions=1).assign(late=0, response_time=1.0)
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
    gone = main.assign(response_x=np.nan, response_y=np.nan)
    assert all(np.isnan(e.mean).all() and e.count == 0 for e in ellipses(gone))


@pytest.mark.parametrize("kept", [{"method": "funneling"}, {"target": "5"}, {"method": "funneling", "target": "5"}])
def test_a_study_of_one_method_or_one_target_is_analysed_as_far_as_it_goes(tmp_path, kept):
    table = answers(people=4, repetitions=3).assign(late=0, response_time=1.0)
    for column, value in kept.items():
        table = table[table[column] == value]
    tests = analyse(with_errors(table, GRID), "error")
    assert tests.effects == ()
    assert len(tests.methods) == ("method" not in kept)
    assert (tests.mixed is None) == (len(kept) == 2)
    page = write_analysis(Study(name="s", scenario="x", tasks=(Task(name="t"),)), {"t": table}, GRID, tmp_path)
    assert "there is no two-way analysis" in page.read_text()
    assert all(len(f.read_text()) > 1 for f in page.parent.glob("*.csv"))
    assert not list(page.parent.glob("*-anova.csv"))


def test_a_table_without_main_trials_is_a_sentence():
    with pytest.raises(DataError, match="phase is 'main' in none of them, but test"):
        with_errors(answers().assign(phase="test"), GRID)


def test_cell_means_put_ten_after_nine():
    table = pd.DataFrame({"participant": ["10", "9"], "target": ["1", "1"], "method": ["a", "a"], "error": [1.0, 2.0]})
    values, people, *_ = cell_means(table, "error")
    assert people == ["9", "10"]
    assert values[:, 0, 0].tolist() == [2.0, 1.0]


_SCENE = """
name = "flat"
engine = "layered"
[device.cone]
contact = "pressure"
[sweep]
sample_rate = 2000.0
duration = 0.2
"""


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


def test_a_rehearsed_study_is_analysed_from_the_command_line(tmp_path):
    """new -> rehearse on the layered twin's G -> analyse -> power: files made, figures opened, no traceback."""
    from PIL import Image

    (tmp_path / "flat.toml").write_text(_SCENE)
    run = CliRunner().invoke
    solved = run(app, ["solve", str(tmp_path / "flat.toml"), "--out", str(tmp_path / "g")])
    assert solved.exit_code == 0, solved.output
    made = run(app, ["study", "new", "pilot", "--scenario", "flat.toml", "--folder", str(tmp_path)])
    assert made.exit_code == 0, made.output
    file = tmp_path / "pilot.toml"
    text = file.read_text().replace('["1", "2", "3", "4", "5", "6", "7", "8", "9"]', '["1", "5", "9"]')
    file.write_text(text.replace("training = 1", "training = 0\nanswer_seconds = 5.0"))
    done = run(app, ["study", "rehearse", str(file), "--transfer", str(tmp_path / "g"), "--participants", "4"])
    assert done.exit_code == 0, done.output
    data = tmp_path / "pilot-rehearsal"
    done = run(app, ["study", "analyse", str(file), "--data", str(data), "--thesis"])
    assert done.exit_code == 0, done.output
    page = (data / "analysis" / "report.html").read_text()
    assert "repetitions were counted as subjects" in page
    assert "none (simulated participants)" in page
    answered = pd.read_csv(data / "sub-01" / "beh" / "sub-01_task-confidence_events.tsv", sep="\t")
    assert answered["response_time"].isna().all()  # an hour each, and so all of them late
    assert not answered["late"].any()
    assert " 3600.0 s" not in page
    for name in ("identification-ellipses", "identification-confusion", "confidence-points"):
        with Image.open(data / "analysis" / f"{name}.png") as picture:
            assert picture.size[0] > 400
    assert "04  confidence: 27 of 27" in run(app, ["study", "status", str(file), "--data", str(data)]).output
