"""Files: our own, and measured G of any known kind; all written atomically."""

from ..store.folder import atomic_path, write_text
from .declaration import Declaration, PortDeclaration
from .matlab import read_thesis_mat, write_thesis_mat
from .netcdf import read_compliance, read_transfer, write_compliance, write_transfer
from .reading import RecognitionWarning
from .recognise import read_measured, write_measured
from .signals import Signals, read_displacements, read_drives, stack, write_displacements, write_drives
from .tables import StrengthRow, read_signal_strength_csv, strength_rows, write_signal_strength_csv
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
