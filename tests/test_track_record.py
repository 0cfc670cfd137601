"""The track record: what reports say of bands is what the manual says, and follows from a validation by hand."""

from __future__ import annotations

import re
from pathlib import Path

from forearm_fem.show.answer import PAGE, TrackRecord, track_record

ROOT = Path(__file__).resolve().parents[1]


def test_the_manual_quotes_the_record() -> None:
    """The page that each report links to has the same counts."""
    text, record = (ROOT / PAGE).read_text(encoding="utf-8"), track_record()
    counts = {what: f"{held} of {of}" for what, held, of in (
        ("nine values of S", record.entries, 9), ("six deviations", record.deviations, 6),
        ("no law was fitted to", record.findings, record.compared))}  # fmt: skip
    for what, told in counts.items():
        assert re.search(rf"{what}[^|]*\| {told} ", text), what
    assert f"{record.entries} of 9" in record.sentence


def test_a_record_counts_what_a_validation_found() -> None:
    entries = [{"inside": k < 4} for k in range(3)]
    found = {"draws": 60, "inside": 7, "deviations": entries, "width": 1.514, "distance": 2.004, "score": -7.02}
    targets = [
        {"fitted": False, "all": {"inside": True}}, {"fitted": False, "all": {"inside": False}},
        {"fitted": True, "all": {"inside": True}}, {"fitted": False, "all": None}, {"fitted": False},
    ]  # fmt: skip
    record = TrackRecord.of({"table_one": {"window": {"all": found}}, "targets": targets})
    assert record == TrackRecord(60, 7, 3, 1, 2, 1.51, 2.0, -7.0)
