"""Everybody's files: G of labs and other programs, read right or refused with the true reason, and G written."""

from .declaration import Declaration, PortDeclaration, RecognitionWarning
from .mat import read_thesis_mat, write_thesis_mat
from .read import read, save
from .reader import RawMatrix, Reader
from .sweeps import read_sweep
from .tables import write_csv

__all__ = [
    "Declaration",
    "PortDeclaration",
    "RawMatrix",
    "Reader",
    "RecognitionWarning",
    "read",
    "read_sweep",
    "read_thesis_mat",
    "save",
    "write_csv",
    "write_thesis_mat",
]
