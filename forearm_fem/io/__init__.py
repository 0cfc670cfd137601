"""Files: our own, and measured G of any known kind; all written atomically."""

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
from .declaration import Declaration, PortDeclaration
from .matlab import read_thesis_mat, write_thesis_mat
from .reading import RecognitionWarning
from .recognise import read_measured, write_measured
from .tdms import read_sweep_tdms

__all__ = [
    "Declaration",
    "PortDeclaration",
    "RecognitionWarning",
    "Signals",
    "StrengthRow",
    "atomic_path",
    "read_compliance",
    "read_displacements",
    "read_drives",
    "read_measured",
    "read_signal_strength_csv",
    "read_sweep_tdms",
    "read_thesis_mat",
    "read_transfer",
    "stack",
    "strength_rows",
    "write_compliance",
    "write_displacements",
    "write_drives",
    "write_measured",
    "write_signal_strength_csv",
    "write_text",
    "write_thesis_mat",
    "write_transfer",
]
