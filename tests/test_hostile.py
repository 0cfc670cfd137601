"""Hostile scenarios of hostile.py, a fixed few by default and a thousand at night: one sentence or a result."""

from __future__ import annotations

import pytest
from hostile import LAYERED, Outcome, outcome, scenario_data
from hypothesis import given
from hypothesis import strategies as st

from forearm_fem.errors import LONGEST_SENTENCE, DataError, one_sentence


@pytest.mark.parametrize("seeds", [range(15), pytest.param(range(15, 1000), marks=pytest.mark.slow)], ids=len)
def test_a_hostile_scenario_gets_a_sentence_or_a_result(seeds: range) -> None:
    for seed in seeds:
        found = outcome(scenario_data(seed, LAYERED), render=False)
        assert found.kind in ("sentence", "ran"), (seed, found.text)


def test_the_judge_sees_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError

    assert outcome(dict(LAYERED)) == Outcome("ran")
    monkeypatch.setattr("hostile.solve_layered", broken)
    assert outcome(dict(LAYERED)).kind == "traceback"


@given(text=st.text(max_size=2000))
def test_every_message_is_one_line_of_at_most_300_characters(text: str) -> None:
    said = str(DataError(text))
    assert len(said) <= LONGEST_SENTENCE
    assert said.isprintable()


def test_a_long_message_keeps_its_key_and_its_remedy() -> None:
    said = one_sentence(f"device.spacing: {'x' * 5000}; use metres")
    assert len(said) == LONGEST_SENTENCE
    assert said.startswith("device.spacing: ")
    assert said.endswith("; use metres")
    assert one_sentence("short") == "short"
