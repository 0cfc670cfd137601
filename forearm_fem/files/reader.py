"""A kind of file: its endings, what may be declared of it, and how its content becomes a matrix."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from ..errors import DataError
from ..transfer import TransferMatrix
from .declaration import EVERY, SWEEPS, Declaration, Ports, RawMatrix
from .meaning import understand


class Reader:
    """Reader of one kind of file.

    ``kind`` names it in sentences, ``endings`` are its files', ``takes`` what may be declared of it beyond
    :data:`.declaration.EVERY`. What a file must say or be told is in :data:`.declaration.NEEDS`.
    """

    kind: ClassVar[str]
    endings: ClassVar[tuple[str, ...]]
    takes: ClassVar[frozenset[str]] = frozenset()

    def raw(self, file: Path, said: Declaration) -> RawMatrix:
        """The content of ``file``; DataError in one sentence for what is wrong with it."""
        raise NotImplementedError

    def read(self, file: Path, said: Declaration, ports: Ports | None) -> TransferMatrix:
        """G in ``file``, of ``ports`` (outputs, inputs) where it names none."""
        return understand(self.checked(file, said), said, ports)

    def checked(self, file: Path, said: Declaration) -> RawMatrix:
        """:meth:`raw`, where all that is declared has an effect; DataError otherwise."""
        self.refuse_idle(file, said)
        raw = self.raw(file, said)
        known = {"outputs": raw.outputs, "inputs": raw.inputs, "sample_rate": raw.frequency}
        if idle := [k for k, own in known.items() if own is not None and getattr(said, k) is not None]:
            raise DataError(
                f"{raw.name}: says that itself, so that {idle[0]} has no effect; leave it out of the declaration"
            )
        return raw

    def refuse_idle(self, file: Path, said: Declaration) -> None:
        """DataError for what is declared and would change nothing of this kind of file."""
        plain = Declaration()
        given = [k for k in Declaration.model_fields if getattr(said, k) != getattr(plain, k)]
        if idle := [k for k in given if k not in EVERY | self.takes]:
            more = ""
            if idle[0] in SWEEPS:
                more = " (it is of raw sweeps: TDMS, LVM, WAV, or tables in time)"
            raise DataError(
                f"{file}: {idle[0]} has no effect on {self.kind}{more}; leave it out of the declaration"
            )
