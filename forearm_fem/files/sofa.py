"""SOFA (AES69), the format of acoustic transfer functions, read through sofar."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.fft import rfft, rfftfreq

from ..errors import DataError, optional
from .declaration import Declaration, RawMatrix
from .reader import Reader
from .reading import reading


class SofaReader(Reader):
    """G of impulse responses (Data.IR) or transfer functions (Data.Real, Data.Imag): measurements are drives,
    receivers are points."""

    kind: ClassVar[str] = "SOFA"
    endings: ClassVar[tuple[str, ...]] = (".sofa",)
    takes = frozenset({"axes"})

    def raw(self, file: Path, said: Declaration) -> RawMatrix:
        """See :meth:`.Reader.raw`."""
        sofar = optional("sofar", "sofa", "reading SOFA files")
        with reading(file, "damaged, cut short or no SOFA file ({why})"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            content: Any = sofar.read_sofa(str(file), verify=False, verbose=False)
            values, frequency = _spectra(file, content)
        return RawMatrix(
            str(file),
            values,
            frequency,
            ("input", "output", "frequency"),
            spectrum="one-sided",
            sign="+iwt" if hasattr(content, "Data_IR") else None,
            provenance={"format": "SOFA", "title": str(getattr(content, "GLOBAL_Title", ""))},
        )


def _spectra(file: Path, content: Any) -> tuple[Any, Any]:
    """(measurement, receiver, frequency) and the frequencies [Hz]."""
    if hasattr(content, "Data_IR"):
        impulses = np.asarray(content.Data_IR, dtype=float)
        rates = np.unique(np.asarray(content.Data_SamplingRate, dtype=float))
        if impulses.ndim != 3 or len(rates) != 1:
            raise DataError(
                f"{file}: its Data.IR has the shape {impulses.shape} at {len(rates)} rates, expected (M, R, N)"
            )
        delay = np.asarray(getattr(content, "Data_Delay", 0.0), dtype=float)
        frequency = rfftfreq(impulses.shape[2], 1 / rates[0])
        late = np.broadcast_to(delay, impulses.shape[:2])[:, :, None] / rates[0]
        return rfft(impulses, axis=2) * np.exp(-2j * np.pi * frequency * late), frequency
    if hasattr(content, "Data_Real") and hasattr(content, "Data_Imag"):
        values = np.asarray(content.Data_Real, dtype=float) + 1j * np.asarray(content.Data_Imag, dtype=float)
        if values.ndim != 3:
            raise DataError(f"{file}: its Data.Real has the shape {values.shape}, expected (M, R, N)")
        return values, np.asarray(content.N, dtype=float).ravel()
    raise DataError(f"{file}: holds neither Data.IR nor Data.Real and Data.Imag, which alone are read")
