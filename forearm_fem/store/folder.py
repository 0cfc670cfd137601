"""Folders: the cache of this machine, and results folders with files whole or absent and one command at a time."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from platformdirs import user_cache_path

from ..errors import DataError


def default_cache_dir() -> Path:
    """$FOREARM_FEM_CACHE, else the system's place: on Linux $XDG_CACHE_HOME/forearm_fem or ~/.cache/forearm_fem.

    A private temporary folder where that cannot be written.
    """
    if own := os.environ.get("FOREARM_FEM_CACHE"):
        return Path(own)
    usual = user_cache_path("forearm_fem", appauthor=False)
    return next((folder for folder in (usual, private_temporary()) if is_writable(folder)), usual)


def private_temporary(end: str = "") -> Path:
    """A folder for this user below the system's temporary one; ask :func:`is_writable` before it is used."""
    user = os.getuid() if hasattr(os, "getuid") else "user"  # Windows has a temporary folder for each user
    return Path(tempfile.gettempdir()) / f"forearm_fem-{user}{end}"


def is_writable(folder: Path) -> bool:
    """True if it is there or can be made, is nobody else's (code that lies in it is run), and takes a file."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
            return False
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


# The results folder: files whole or absent, one command at a time, its kind, and ``SHA256SUMS``.

LOCK, RECORD, SUMS = ".lock", "folder.json", "SHA256SUMS"
_ALONE = ("run", "design", "campaign", "study", "calibration", "prediction")  # kinds that share a folder with no other


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """A path beside ``path`` to write to; it takes ``path``'s place when the block ends without failure.

    Folders are made as needed, and data are on the disk before the old file is replaced. After a failure the old file
    stands and nothing is left beside it. The suffix is kept, for writers that look at it. Raises DataError where the
    file cannot be written.
    """
    target = Path(path)
    beside = target.with_name(f".{target.stem}-{secrets.token_hex(4)}{target.suffix}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield beside
        with beside.open("rb+") as stream:
            os.fsync(stream.fileno())
        os.replace(beside, target)
        _flush_folder(target.parent)
    except OSError as problem:
        raise DataError(f"{target}: cannot be written ({problem.strerror or problem})") from problem
    finally:
        with suppress(OSError):
            beside.unlink()


def refuse_no_file(file: Path) -> None:
    """DataError where ``file`` is a folder, or is not there."""
    if not file.is_file():
        raise DataError(f"{file}: {'is a folder, expected a file' if file.is_dir() else 'no such file'}")


def write_bytes(path: str | Path, content: bytes) -> None:
    """``content``, whole or not at all.

    Libraries write into memory, and the memory goes here: on a full disk HDF5 leaves objects behind that crash the
    process when they are closed.
    """
    with atomic_path(path) as beside:
        beside.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """``text`` as UTF-8 with the line ends it has, whole or not at all."""
    write_bytes(path, text.encode("utf-8"))


def _flush_folder(folder: Path) -> None:
    """Make the renaming itself durable; Windows cannot open folders and needs no such step."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def locked(folder: str | Path, *, sums: bool = True) -> Iterator[None]:
    """Hold ``folder`` (made as needed) for this process until the block ends, then bring its ``sums`` up to date.

    The lock is the operating system's own, on the file ``.lock``: it ends with its process, however that ends. The file
    is removed afterwards, and folders that were made for it and stayed empty. Raises DataError where another process
    holds the folder or where it cannot be written. Not covered: two machines on a file system that shares no locks.
    """
    place = Path(folder)
    made = [p for p in (place, *place.parents) if not p.exists()]
    file = place / LOCK
    lock = FileLock(file, timeout=0)
    try:
        place.mkdir(parents=True, exist_ok=True)
        lock.acquire()
        with suppress(OSError):  # Windows lets nobody write into a locked file
            file.write_text(str(os.getpid()), encoding="ascii")
    except Timeout:
        with suppress(OSError):
            holder = f" (process {text})" if (text := file.read_text(encoding="ascii").strip()) else ""
            raise DataError(_HELD.format(folder=place, holder=holder)) from None
        raise DataError(_HELD.format(folder=place, holder="")) from None
    except OSError as problem:
        why = "it is a file and no folder" if place.is_file() else problem.strerror or problem
        raise DataError(f"{place}: cannot be written ({why}); name another folder") from None
    before = _stamps(place) if sums else {}
    try:
        yield
    finally:
        if sums:
            with suppress(DataError, OSError):
                write_sums(place, before)
        with suppress(OSError):  # while its lock is held, so that nobody locks a file that is about to vanish unseen
            file.unlink()
        lock.release()
        with suppress(OSError):  # Windows removes no open file
            file.unlink()
        for empty in made:
            with suppress(OSError):
                empty.rmdir()


_HELD = (
    "{folder}: another forearm-fem command{holder} works in this folder; wait until it is done, or name another folder "
    "with --out"
)


def write_sums(folder: Path, before: Mapping[str, tuple[int, int]]) -> None:
    """``SHA256SUMS`` as sha256sum writes it; files that stand as ``before`` keep the line they have, if any.

    Listed are files of the folder and of folders in it, less hidden ones and folders with a list of their own.
    """
    now, known = _stamps(folder), dict[str, str]()
    if now == before:
        return
    with suppress(OSError, UnicodeDecodeError):
        lines = (folder / SUMS).read_text(encoding="utf-8").splitlines()
        known = {name: digest for digest, _, name in (line.partition("  ") for line in lines)}
    found: dict[str, str] = {}
    for name, stamp in sorted(now.items()):
        if before.get(name) != stamp:
            with (folder / name).open("rb") as stream:
                found[name] = hashlib.file_digest(stream, "sha256").hexdigest()
        elif name in known:
            found[name] = known[name]
    write_text(folder / SUMS, "".join(f"{digest}  {name}\n" for name, digest in found.items()))


def _stamps(folder: Path) -> dict[str, tuple[int, int]]:
    """Time of change [ns] and size of each file that ``SHA256SUMS`` may list."""
    found: dict[str, tuple[int, int]] = {}
    inner = (p for p in folder.iterdir() if p.is_dir() and not p.name.startswith(".") and not (p / SUMS).exists())
    for part in (folder, *inner):
        with suppress(OSError):  # a folder that may not be read
            for path in part.iterdir():
                if path.is_file() and not path.name.startswith(".") and path.name != SUMS:
                    stat = path.stat()
                    found[path.relative_to(folder).as_posix()] = stat.st_mtime_ns, stat.st_size
    return found


def check_kind(
    folder: str | Path, kind: str, asked: Mapping[str, Any] | None = None, files: Sequence[str] = ()
) -> None:
    """Look at ``folder`` before work of a ``kind`` begins in it.

    DataError where it is a run, design, campaign, study, calibration or prediction and ``kind`` is another of these.
    So, too, where one of ``files`` is there that no earlier work of this kind wrote. A warning where these answered
    another question than ``asked``. Folders inside it, such as a campaign's members, have kinds of their own.
    """
    place, record = Path(folder), _record(folder)
    if kind in _ALONE and (other := next((k for k in record if k in _ALONE and k != kind), None)):
        raise DataError(f"{folder}: holds a {other} ({RECORD}), with which a {kind} does not mix; name another folder")
    there = [name for name in files if (place / name).exists()]
    if there and kind not in record:
        raise DataError(f"{place / there[0]}: is no earlier result of this command; name another folder with --out")
    if there and asked is not None and record[kind] != json.loads(json.dumps(asked)):
        warnings.warn(f"{folder}: its {', '.join(there)} answered another question and are replaced", stacklevel=3)


def set_kind(folder: str | Path, kind: str, asked: Mapping[str, Any] | None = None, files: Sequence[str] = ()) -> None:
    """Say in ``folder.json`` that the folder is of this ``kind`` and what was ``asked``; earlier ``files`` go."""
    record = _record(folder)
    plain = json.loads(json.dumps(asked or {}))
    if record.get(kind) != plain:
        write_text(Path(folder) / RECORD, json.dumps({**record, kind: plain}, indent=1) + "\n")
    for name in files:
        (Path(folder) / name).unlink(missing_ok=True)


def _record(folder: str | Path) -> dict[str, Any]:
    """Record in the folder; nothing where it is missing or damaged."""
    with suppress(OSError, ValueError):
        found = json.loads((Path(folder) / RECORD).read_text(encoding="utf-8"))
        return found if isinstance(found, dict) else {}
    return {}
