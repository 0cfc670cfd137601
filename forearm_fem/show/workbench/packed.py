"""Arrays as text in JSON: base64 of their bytes, little-endian, with kind and shape."""

from __future__ import annotations

import base64
from typing import Any, Literal

import numpy as np

from ...typing import ComplexArray

Kind = Literal["f4", "f8", "i2", "u2", "u4", "i4", "u1", "c8", "c16"]


def packed(values: Any, kind: Kind) -> dict[str, Any]:
    """``values`` as ``kind``; complex ones lie as pairs (real, imaginary). The page reads it in ``arrays.js``."""
    array = np.asarray(values)
    data = np.ascontiguousarray(array.astype(f"<{kind}")).tobytes()
    return {"kind": kind, "shape": list(array.shape), "data": base64.b64encode(data).decode()}


def in_half_precision(basis: Any) -> dict[str, Any]:
    """``basis`` (..., k) in 16 bits a value: column by column in parts of its largest, to 1.5e-5 of it."""
    array = np.asarray(basis)
    scale = np.abs(array).reshape(-1, array.shape[-1]).max(axis=0) / 32767
    scale[scale == 0] = 1.0
    return {"scale": packed(scale, "f4"), "values": packed(np.rint(array / scale), "i2")}


def amplitudes_in_half_precision(amplitudes: ComplexArray) -> dict[str, Any]:
    """``amplitudes`` (n_frequency, k, n_input) in 16 bits a part: each frequency and input in parts of its largest."""
    scale = np.abs(amplitudes).max(axis=1, keepdims=True) / 32767
    scale[scale == 0] = 1.0
    parts = np.stack([(amplitudes / scale).real, (amplitudes / scale).imag], axis=-1)
    return {"scale": packed(scale[:, 0], "f4"), "values": packed(np.rint(parts), "i2")}
