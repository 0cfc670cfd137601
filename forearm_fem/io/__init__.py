"""Files of our own, written atomically; those of others are read by :mod:`forearm_fem.files`."""

from ..store.folder import atomic_path, write_text
from ..store.results import (
    Signals,
    StrengthRow,
    read_compliance,
    read_displacements,
    read_drives,
    read_signal_strength_csv,
    read_transfer,
    stack,
    strength_rows,
    write_compliance,
    write_displacements,
    write_drives,
    write_signal_strength_csv,
    write_transfer,
)

__all__ = [
    "Signals",
    "StrengthRow",
    "atomic_path",
    "read_compliance",
    "read_displacements",
    "read_drives",
    "read_signal_strength_csv",
    "read_transfer",
    "stack",
    "strength_rows",
    "write_compliance",
    "write_displacements",
    "write_drives",
    "write_signal_strength_csv",
    "write_text",
    "write_transfer",
]
