"""Whose a results folder is: the files of a run lie beside those of no other command."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from ..errors import DataError

_MARKS: Mapping[str, str] = MappingProxyType({  # a file that no other kind of folder holds
    "run": "run.json", "design": "candidates.jsonl", "campaign": "summary.md", "study": "study.json",
    "calibration": "session.json", "prediction": "draws.nc",
})  # fmt: skip


def refuse_folder_of_another(folder: str | Path, own: str) -> None:
    """DataError where ``folder`` is of another kind than ``own``, whose report would mix with what lies there.

    Kinds are run, design, campaign, study, calibration and prediction, each known by a file. Folders inside it, such as
    a campaign's members, have kinds of their own. A comparison, a fit and figures may lie in a run's folder.
    """
    for kind, mark in _MARKS.items():
        if kind != own and (Path(folder) / mark).is_file():
            raise DataError(f"{folder}: holds a {kind} ({mark}), with which a {own} does not mix; name another folder")
