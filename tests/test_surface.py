"""The program from Python and with the user's own file: surface, renderer, tissue law."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_runner import SMALL as SHORT
from cli_runner import cli
from scenes import shows_itself

from forearm_fem import Law, Simulation, load_scenario, read, render, simulate
from forearm_fem.engines.fem import FemEngine
from forearm_fem.engines.layered import LayeredArm, LayeredEngine
from forearm_fem.engines.simulation import Engine
from forearm_fem.errors import DataError, ScenarioError
from forearm_fem.questions.compare.parameters import common_parameters
from forearm_fem.questions.compare.run import run_compare
from forearm_fem.questions.design.candidate import TabulatedArm
from forearm_fem.questions.predict.draws import draw_inputs, load_priors, scenario_of
from forearm_fem.questions.predict.run import Question, check_question, predict
from forearm_fem.rendering.job import check_servable
from forearm_fem.scenario import parse_scenario
from forearm_fem.scenario.model import resolve_tissues
from forearm_fem.scenario.text import contents, law_files, named_files
from forearm_fem.tissue import SpringPot, Zener
from forearm_fem.transfer import ErrorEstimate

SMALL = SHORT.replace("f_max = 300.0", "f_max = 700.0")  # all of the wavelet
PAGE = (Path(__file__).parents[1] / "docs" / "howto" / "extend.md").read_text(encoding="utf-8")


def on_page(heading: str, kind: str = "python") -> str:
    """The first block of code of a kind below a heading of the manual's page."""
    below = PAGE.partition(f"\n## {heading}\n")[2]
    return below.partition(f"```{kind}\n")[2].partition("```")[0]


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scenario, and beside it the files of the manual's page."""
    folder = tmp_path_factory.mktemp("user")
    for heading in ("A renderer", "A tissue law", "An engine", "A file format"):
        code = on_page(heading)
        (folder / re.match(r"# (\w+\.py)", code)[1]).write_text(code)
    (folder / "small.toml").write_text(SMALL)
    return folder


@pytest.fixture(scope="module")
def simulation(home: Path) -> Simulation:
    return simulate(load_scenario(home / "small.toml"))


def test_every_public_name_is_there():
    """Also after the rooms are loaded, whose names may be the same."""
    import forearm_fem.questions.compare.run
    import forearm_fem.questions.design.run

    for name in forearm_fem.__all__:
        assert getattr(forearm_fem, name) is not None
    for verb in ("calibrate", "compare", "design", "fit", "predict", "read", "render", "simulate"):
        assert callable(getattr(forearm_fem, verb))
    assert len(forearm_fem.__all__) <= 26


def test_whatever_shows_g_or_s_tells_its_error_or_that_it_is_unknown(simulation: Simulation):
    bare, s = replace(simulation.transfer, errors=()), simulation.strength
    cut = replace(bare, errors=(ErrorEstimate("truncation", 0.021, "test"),))
    lost = replace(bare, errors=(*cut.errors, ErrorEstimate("discretisation", np.nan, "test")))
    scatter = replace(bare, errors=(ErrorEstimate("measurement", 0.021, "test"),))
    for g, said in ((bare, "error unknown"), (cut, "error 2.1 %"), (lost, "error unknown"),
                    (scatter, "scatter 2.1 %, systematic error unknown")):  # fmt: skip
        assert f"; {said}>" in repr(g)
        assert said in g._repr_html_()
        known = [e.band for e in g.errors]
        np.testing.assert_equal(g.to_xarray().attrs["error"], known[0] if len(known) == 1 else np.nan)
    assert "Of itself A states: error unknown; B: error 2.1 %." in run_compare(bare, cut, render=False).text
    nothing = np.full(s.value.shape, np.nan)
    for shown, said in ((s, "either way at most"), (replace(s, low=nothing, high=nothing), "interval unknown")):
        assert said in repr(shown)
        assert (shown.plot().axes[0].get_title() == "interval unknown") is (shown is not s)


def test_results_have_a_notebook_s_manners(simulation: Simulation, tmp_path: Path):
    g, s = simulation.transfer, simulation.strength
    for what in (simulation, g, s, simulation.rendering, simulation.compliance):
        assert "\n" not in repr(what)
        assert len(repr(what)) < 200
    assert "<table>" in g._repr_html_()
    assert "<table>" in s._repr_html_()
    assert np.array_equal(simulation.sel("5", "A1"), g.values[:, 4, 0])
    assert np.array_equal(g.to_xarray().sel(output="5", input="A1").values, g.values[:, 4, 0])
    entry = s.sel("funneling", "5")
    assert entry.low < entry.value < entry.high
    assert float(s.to_xarray()["low"].sel(renderer="funneling", target="5")) == entry.low
    assert simulation.rendering.to_xarray()["drives"].dims == ("renderer", "target", "actuator", "time")
    assert s.plot().axes
    assert g.plot().axes
    g.save(tmp_path / "g.nc")
    assert np.array_equal(read(tmp_path / "g.nc").values, g.values)
    with pytest.raises(DataError, match="A1, A2"):
        g.sel("5", "A9")


def test_s_of_a_g_read_from_a_file_is_s_of_the_simulation(simulation: Simulation, tmp_path: Path):
    """The file names its scenario, so the same methods play, and the intervals are the same to the last digit."""
    simulation.save(tmp_path / "g.nc")
    again = render(read(tmp_path / "g.nc")).strength
    assert np.array_equal(again.value, simulation.strength.value)
    assert np.array_equal(again.high, simulation.strength.high)


def test_a_renderer_of_one_s_own_runs_from_a_scenario(home: Path, simulation: Simulation, tmp_path: Path):
    text = SMALL.replace("[rendering]", '[rendering]\nmethods = ["mine:TimeReversal", "funneling"]')
    (home / "loud.toml").write_text(text)
    found = replace(simulation, scenario=load_scenario(home / "loud.toml")).strength
    assert found.methods == ("time reversal", "funneling")
    assert np.isfinite(found.value).all()
    assert (found.high > found.low).all()
    answer = cli("run", home / "loud.toml", "--out", tmp_path / "out", cwd=tmp_path)  # from another folder
    assert answer.code == 0, answer.err
    assert "time reversal" in (tmp_path / "out" / "report.md").read_text()


def test_a_tissue_law_of_one_s_own_gives_the_g_of_the_same_law(home: Path, simulation: Simulation):
    """Kelvin-Voigt written by hand is Kelvin-Voigt: layers ask for mu* alone, so that G is equal to rounding."""
    (home / "lawful.toml").write_text(SMALL + on_page("A tissue law", "toml"))
    scenario = load_scenario(home / "lawful.toml")
    assert isinstance(resolve_tissues(scenario)["skin"].modulus, Law)
    np.testing.assert_allclose(simulate(scenario).transfer.values, simulation.transfer.values, rtol=1e-9)
    assert common_parameters(scenario, ["skin.loss"])[0].name == "tissues.override.skin.parameters.loss"


def test_arms_are_drawn_of_a_law_of_one_s_own(home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """As its class says how people differ, by its name beside the scenario; a class that does not say is refused."""
    monkeypatch.setattr("forearm_fem.questions.predict.statistics.LEAST", 2)  # of 20 draws that a band needs
    (tmp_path / "here.toml").write_text(f'{SHORT}\n[device.cone]\ncontact = "pressure"\n')
    code = on_page("A tissue law")
    (tmp_path / "stiffening.py").write_text(code)
    (tmp_path / "silent.py").write_text(code.replace("    drawn =", "    said ="))
    scenario = load_scenario(tmp_path / "here.toml")
    question = Question(scenario, tmp_path, laws=("stiffening:Stiffening",), held=("measurement",))
    found = predict(question, tmp_path / "out", draws=2, workers=1)
    assert {law.rpartition(":")[2] for law in found.draws.laws} == {"Stiffening"}
    assert np.isfinite(found.draws.strengths).all()
    shows_itself(found)
    assert np.array_equal(found.sel("funneling", "5"), found.draws.reading("played")[:, 1, 0])
    assert {"skin stiffness", "skin loss"} <= set(found.draws.names)
    draw = draw_inputs(load_priors(), scenario, 0, 1, [f"{tmp_path / 'stiffening.py'}:Stiffening"])
    drawn = resolve_tissues(scenario_of(draw, scenario))
    assert (drawn["skin"].modulus.mu, drawn["skin"].modulus.loss) == (draw.values["skin.mu"], draw.values["skin.loss"])
    assert drawn["fat"] == resolve_tissues(scenario)["fat"]  # the class says nothing of fat
    with pytest.raises(ScenarioError, match="how arms differ"):
        check_question(Question(scenario, tmp_path, laws=("silent:Stiffening",)))


def test_an_engine_of_one_s_own_answers_for_a_scenario(home: Path, simulation: Simulation, tmp_path: Path):
    """Under forces skin twice as soft moves twice as far; what the engine does not hold is refused in its words."""
    forces = SHORT.replace('engine = "layered"', 'engine = "soft:Softer"') + '\n[device]\ndrive = "force"\n'
    (home / "soft.toml").write_text(forces)
    scenario = load_scenario(home / "soft.toml")
    layered = simulate(scenario.changed({"engine": "layered"})).transfer.values
    np.testing.assert_allclose(simulate(scenario).transfer.values, 2 * layered, rtol=1e-12)
    assert cli("run", "--until", "solve", home / "soft.toml", "--out", tmp_path / "out").code == 0
    with pytest.raises(ScenarioError, match="ends at 300 Hz"):
        simulate(scenario.changed({"sweep.f_max": 400.0}))


def test_a_file_of_one_s_own_format_is_read(home: Path, simulation: Simulation, tmp_path: Path):
    """To the last digit, and by the command line to S."""
    g = simulation.transfer
    flat = g.values.reshape(len(g.frequency), -1)
    pairs = np.stack([flat.real, flat.imag], axis=2).reshape(len(g.frequency), -1)
    np.savetxt(tmp_path / "g.vib", np.column_stack([g.frequency, pairs]), fmt="%.17g")
    code = f"{home / 'lab.py'}:LabFile"
    found = read(tmp_path / "g.vib", scenario=simulation.scenario, reader=code)
    assert np.array_equal(found.values, g.values)
    said = ("--scenario", home / "small.toml", "--declare", f"reader={code}", "--out", tmp_path / "out")
    answer = cli("render", tmp_path / "g.vib", *said)
    assert answer.code == 0, answer.err
    with pytest.raises(DataError, match="is no reader"):
        read(tmp_path / "g.vib", scenario=simulation.scenario, reader=f"{home / 'stiffening.py'}:Stiffening")


@pytest.mark.parametrize("engine", [LayeredEngine(), FemEngine(), TabulatedArm(), LayeredArm()])
def test_engines_are_engines(engine: Engine):
    """One protocol: each says its name and what it holds; layers are what three of four need."""
    scenario = load_scenario("quick")
    assert engine.name
    assert engine.holds(scenario) == ""
    assert bool(engine.holds(load_scenario("own_arm"))) == (engine.name != "fem")


def test_a_law_that_was_edited_is_another_question(home: Path):
    """What is kept of solves and predictions hangs on the code behind a name, not on the name alone."""
    (home / "edited.py").write_text((home / "stiffening.py").read_text())
    scenario = parse_scenario(
        {"tissues": {"override": {"skin": {"law": f"{home / 'edited.py'}:Stiffening", "mu": 13e3}}}}
    )
    before = contents(law_files(scenario), home), contents(named_files(scenario), home)
    with (home / "edited.py").open("a") as file:
        file.write("# softer\n")
    after = contents(law_files(scenario), home), contents(named_files(scenario), home)
    assert len(before[0]) == len(before[1]) == 1
    assert before[0] != after[0]
    assert before[1] != after[1]


@pytest.mark.parametrize("law", [Zener(13e3, 40e3, 8.0), SpringPot(5e3, 0.4)])
@pytest.mark.parametrize("omega", [100.0, 2000.0])
def test_series_that_a_law_need_not_give(law: Zener | SpringPot, omega: float):
    """Cauchy's integral against the closed series, term by term within the reach of half the circle."""

    class Bare(Law):
        def at(self, omega):
            s = 1j * np.asarray(omega)
            if isinstance(law, Zener):
                return law.mu + s * law.eta / (1 + s * law.relaxation_time)
            return law.mu ** (1 - law.exponent) * (law.eta * s) ** law.exponent

    reach = (0.15 * omega) ** np.arange(10)
    np.testing.assert_allclose(Bare().taylor(omega, 9) * reach, law.taylor(omega, 9) * reach, atol=1e-9 * law.mu)


@pytest.mark.parametrize(("code", "said"), [("none:TimeReversal", "no module"), ("mine:Softest", "has no Softest")])
def test_code_that_is_not_there_is_said(home: Path, simulation: Simulation, code: str, said: str):
    (home / "wrong.toml").write_text(SMALL.replace("[rendering]", f'[rendering]\nmethods = ["{code}"]'))
    with pytest.raises(ScenarioError, match=said):
        replace(simulation, scenario=load_scenario(home / "wrong.toml")).strength  # noqa: B018
    with pytest.raises(ScenarioError, match=said):  # and before anything is solved
        check_servable(load_scenario(home / "wrong.toml"))
