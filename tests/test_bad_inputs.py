"""Every wrong input gets one sentence and exit code 2, and leaves nothing behind."""

from __future__ import annotations

from pathlib import Path

import pytest
from bad_inputs import CASES, Case, prepare
from cli_runner import cli, leftovers
from scenes import sampled

from forearm_fem.store.folder import RECORD, SUMS


@pytest.mark.parametrize("case", sampled(CASES, 2), ids=[c.name.replace(" ", "_") for c in CASES])
def test_wrong_input_gets_one_sentence(case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path.parent / "cache"))
    arguments = prepare(case, tmp_path)
    answer = cli(*arguments, cwd=tmp_path)
    assert answer.code == 2, answer
    assert "Traceback" not in answer.err
    for words in case.says:
        assert words in answer.sentence
    assert sorted({*leftovers(tmp_path / "out")} - {RECORD, SUMS}) == list(case.left)
    assert len(answer.sentence) <= 300
