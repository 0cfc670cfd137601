"""The record of a run: typed, versioned, read back as written and from every older version."""

import json

import numpy as np
import pytest

from forearm_fem.errors import DataError
from forearm_fem.ports import Port
from forearm_fem.results.run import (
    ErrorRecord,
    RunRecord,
    StageCost,
    StrengthRecord,
    condition_of,
    read_run,
    write_run,
)
from forearm_fem.show.data import Results
from forearm_fem.transfer import ErrorEstimate, TransferMatrix


def record(**changes) -> RunRecord:
    """A small record with every kind of value."""
    strength = {
        "window": [0.9, 1.1],
        "methods": {"funneling": {"5": {"value": 2.0, "low": None, "edges": -0.1, "holes": 0.0}}},
        "zeros": {"funneling": {"5": ["1", "3"]}},
    }
    known = {
        "program": "0.14.0",
        "stages": {"mesh": StageCost(seconds=2.5), "solve": StageCost(seconds=0.5, peak_memory_bytes=1e9)},
        "notes": ("a note",),
        "errors": (
            ErrorRecord.of(ErrorEstimate("reduction", 1e-5, "certificates")),
            ErrorRecord.of(ErrorEstimate("truncation", float("nan"), "ends could not be freed")),
        ),
        "mesh": {"sha256": "ab", "quality": {"least": 0.1, "median": 0.6}, "resolution": []},
        "signal_strength": StrengthRecord.model_validate(strength),
    }
    return RunRecord.model_validate({**known, **changes})


def test_a_record_is_read_back_as_written(tmp_path):
    write_run(tmp_path / "run.json", record())
    assert read_run(tmp_path / "run.json") == record()
    text = (tmp_path / "run.json").read_text()
    json.loads(text, parse_constant=pytest.fail)  # JSON has no NaN
    assert json.loads(text)["version"] == 1


def test_what_could_not_be_estimated_is_unknown_and_makes_the_total_unknown():
    assert record().errors[1].band is None
    assert record().band_error is None
    assert record(errors=record().errors[:1]).band_error == 1e-5
    assert record(errors=()).band_error is None
    both = (ErrorRecord.of(ErrorEstimate(s, b, "")) for s, b in (("reduction", 3e-5), ("truncation", 4e-5)))
    assert record(errors=tuple(both)).band_error == pytest.approx(5e-5)  # as total_error
    assert record().seconds == 3.0


def test_records_of_older_and_of_newer_programs_keep_what_this_one_does_not_know(tmp_path):
    """0.1 wrote peak_memory and warnings; a key to come is kept and written again."""
    old = {
        "program": "0.1.0", "notes": [], "warnings": ["once"], "odd": {"a": 1},
        "stages": {"solve": {"seconds": 1.0, "peak_memory": 5.0}},
    }  # fmt: skip
    (tmp_path / "run.json").write_text(json.dumps(old))
    found = read_run(tmp_path / "run.json")
    assert found.stages["solve"].peak_memory_bytes == 5.0
    assert found.warnings == ("once",)
    assert (found.accuracy, found.errors, found.mesh.sha256, found.signal_strength.methods) == ("", (), "", {})
    write_run(tmp_path / "again.json", found)
    assert json.loads((tmp_path / "again.json").read_text())["odd"] == {"a": 1}
    assert read_run(tmp_path / "again.json") == found


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"stages": {"solve": {"seconds": "soon"}}}, "damaged at stages.solve.seconds"),
        ({"notes": "none"}, "damaged at notes"),
        ({"version": 2, "program": "9.0"}, "written by a newer forearm_fem (9.0); update to read it"),
        ({"stages": None}, "damaged at stages"),
    ],
)
def test_what_is_no_record_is_one_sentence(change, told, tmp_path):
    file = tmp_path / "run.json"
    file.write_text(json.dumps({**record().model_dump(mode="json"), **change}))
    with pytest.raises(DataError) as problem:
        read_run(file)
    assert told in str(problem.value)
    assert len(str(problem.value)) <= 300 + len(str(tmp_path))
    with pytest.raises(DataError, match="makes it anew"):
        _ = Results.open(tmp_path).run


def test_the_largest_change_of_s_says_where():
    strength = record().signal_strength
    assert strength.largest("edges") == (0.05, "funneling towards 5")
    assert strength.largest("holes") == (0.0, "funneling towards 5")
    assert StrengthRecord().largest("edges") == (0.0, "")


def test_frequencies_where_g_is_singular_are_counted_apart():
    one = np.array([[2.0, 0.0], [0.0, 1.0]])
    values = np.stack([one, one * [1.0, 0.0], np.full((2, 2), np.nan)]).astype(complex)
    ports = tuple(Port(str(i), "point", (0.01 * i, 0.0, 0.0), (0.0, 0.0, 1.0)) for i in (1, 2))
    found = condition_of(TransferMatrix(np.array([10.0, 20.0, 30.0]), values, ports, ports, "m/V"))
    assert (found.least, found.largest, found.singular) == (2.0, 2.0, 1)
