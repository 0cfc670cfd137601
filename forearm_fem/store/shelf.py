"""The shelf: finished parts by key in one SQLite file."""

from __future__ import annotations

import json
import logging
import sqlite3
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..errors import DataError
from .record import from_parts, to_parts

R = TypeVar("R")
WORK = "work.sqlite"  # a results folder's shelf
_PLAIN, _LARGEST = ".plain", 2**26  # the name that plain values stand under; bytes in a row
_TABLE = "create table if not exists part (key text, name text, kind text, data blob, sum integer)"
_INDEX = "create index if not exists by_key on part (key)"
_log = logging.getLogger("forearm_fem.store")


class Shelf:
    """Arrays, plain values and records by key in ``file``; several processes may use one.

    A write is whole or absent, however the process ends. A damaged part was never there, and a damaged file is an empty
    shelf. What cannot be written costs the reuse only: it is told once in the log as ``what`` could not be kept.
    """

    def __init__(self, file: str | Path, what: str = "what is finished") -> None:
        self.file, self._what, self._told = Path(file), what, False

    def known(self) -> tuple[str, ...]:
        """Keys of all parts, in the order in which they came; some may be damaged."""
        asked, rows = "select key from part where name = ? order by rowid", []
        with self._reading() as base:
            if base:
                rows = base.execute(asked, (_PLAIN,)).fetchall()
        return tuple(key for (key,) in rows)

    def get(self, key: str) -> dict[str, Any] | None:
        """Data put under ``key``; None for none, or damaged data."""
        rows: list[Any] = []
        with self._reading() as base:
            if base:
                asked = "select name, kind, data, sum from part where key = ? order by rowid"
                rows = base.execute(asked, (key,)).fetchall()
        if not rows or any(zlib.crc32(data, zlib.crc32(f"{n}{k}".encode())) != s for n, k, data, s in rows):
            return None
        parts: dict[str, tuple[str, list[bytes]]] = {}
        for name, kind, data, _ in rows:
            parts.setdefault(name, (kind, []))[1].append(data)
        plain: dict[str, Any] = json.loads(parts.pop(_PLAIN)[1][0]) if _PLAIN in parts else {}
        if set(plain.get("arrays", ())) != set(parts):
            return None
        return {**plain["values"], **{name: _array(kind, data) for name, (kind, data) in parts.items()}}

    def put(self, key: str, parts: Mapping[str, Any]) -> bool:
        """Keep arrays, and values that JSON has, by name in place of what was under ``key``; whether that was done."""
        arrays = {n: v for n, v in parts.items() if isinstance(v, np.ndarray)}
        values = {n: v for n, v in parts.items() if n not in arrays}
        text = json.dumps({"values": values, "arrays": list(arrays)}, default=_number).encode()

        def write(base: sqlite3.Connection) -> None:
            """In one transaction."""
            base.execute("delete from part where key = ?", (key,))
            for name, kind, data in ((_PLAIN, "", text), *_rows(arrays)):
                total = zlib.crc32(data, zlib.crc32(f"{name}{kind}".encode()))
                base.execute("insert into part values (?, ?, ?, ?, ?)", (key, name, kind, data, total))

        return self._written(write)

    def drop(self, *keys: str) -> None:
        """Remove the parts of ``keys``."""
        if keys and self.file.exists():
            self._written(lambda base: base.executemany("delete from part where key = ?", [(key,) for key in keys]))

    def remove(self) -> None:
        """Remove the file."""
        for file in (self.file, self.file.with_name(f"{self.file.name}-journal")):
            with suppress(OSError):
                file.unlink(missing_ok=True)

    def record(self, key: str, cls: type[R]) -> R | None:
        """The record of a class under ``key``, or None."""
        parts = self.get(key)
        with suppress(DataError, KeyError, ValueError, TypeError):
            return None if parts is None else from_parts(cls, parts)
        return None

    def keep(self, key: str, record: Any) -> bool:
        """Keep a record under ``key``; whether that was done."""
        return self.put(key, to_parts(record))

    def once(self, key: str, cls: type[R], make: Callable[[], R]) -> R:
        """The record under ``key``, else made and kept."""
        if (found := self.record(key, cls)) is not None:
            return found
        made = make()
        self.keep(key, made)
        return made

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection | None]:
        """A connection, None where there is no file; a damaged one goes."""
        if not self.file.is_file():
            yield None
            return
        try:
            with closing(sqlite3.connect(f"{self.file.absolute().as_uri()}?mode=rw", uri=True, timeout=60)) as base:
                yield base
        except sqlite3.OperationalError as problem:  # locked for long, or without its table
            if "no such table" not in str(problem):
                self._tell(problem)
        except sqlite3.DatabaseError as problem:
            self._tell(problem)
            self.remove()

    def _written(self, write: Callable[[sqlite3.Connection], Any]) -> bool:
        """A transaction; a damaged file is made anew before it, what fails in it is told."""
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            with closing(self._opened()) as base, base:
                write(base)
            return True
        except (sqlite3.Error, OSError) as problem:
            self._tell(problem)
            return False

    def _opened(self) -> sqlite3.Connection:
        for again in (True, False):
            base = sqlite3.connect(self.file, timeout=60)
            try:
                base.execute(_TABLE)
                base.execute(_INDEX)
                return base
            except sqlite3.OperationalError:
                base.close()
                raise
            except sqlite3.DatabaseError:
                base.close()
                if not again:
                    raise
                self.remove()
        raise AssertionError

    def _tell(self, problem: Exception) -> None:
        if not self._told:
            _log.warning("%s could not be kept or found in %s (%s); it is made again", self._what, self.file, problem)
        self._told = True


def _rows(arrays: Mapping[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """Name, kind and bytes of arrays, in pieces that SQLite takes."""
    for name, array in arrays.items():
        order = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"  # sums hang on it
        flat = array.reshape(-1, order=order)
        data = memoryview(flat.view(np.uint8)) if flat.size else memoryview(b"")
        kind = json.dumps([array.dtype.str, array.shape, order])
        for start in range(0, max(1, len(data)), _LARGEST):
            yield name, kind, data[start : start + _LARGEST]


def _array(kind: str, data: list[bytes]) -> Any:
    dtype, shape, order = json.loads(kind)
    whole = bytearray(data[0]) if len(data) == 1 else bytearray().join(data)
    return np.frombuffer(whole, dtype=np.dtype(dtype)).reshape(shape, order=order)


def _number(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    return value.item() if isinstance(value, np.generic) else str(value)
