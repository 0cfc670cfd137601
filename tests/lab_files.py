"""Files as labs have them, made by other people's libraries: UFF by pyuff, TDMS by npTDMS, MATLAB by scipy and h5py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyuff
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from forearm_fem.measurement.recording import Recording
from forearm_fem.transfer import TransferMatrix

AXES = ("frequency", "output", "input")


def uff(file: Path, g: TransferMatrix, **changes: Any) -> Path:
    """G as binary functions of an analyser, a node per point and per actuator; masked bins are left out."""
    for o, i in np.ndindex(*g.values.shape[1:]):
        known = np.isfinite(g.values[:, o, i]) if g.valid is None else g.valid[:, o, i]
        if not known.any():
            continue
        x, data = g.frequency[known], g.values[known, o, i]
        block = pyuff.prepare_58(**{
            "binary": 0, "func_type": 4, "rsp_node": o + 1, "rsp_dir": 3, "ref_node": i + 1, "ref_dir": 3, "data": data,
            "x": x, "num_pts": len(x), "ord_data_type": 6, "abscissa_spacing": 0, "abscissa_spec_data_type": 18,
            "ordinate_spec_data_type": 8, "ordinate_axis_units_lab": "m", "orddenom_spec_data_type": 0,
            "orddenom_axis_units_lab": "V", "id1": "a lab", "abscissa_axis_units_lab": "Hz", **changes,
        })  # fmt: skip
        pyuff.UFF(str(file)).write_sets(block, mode="add")
    return file


def mat5(file: Path, g: TransferMatrix, axes: tuple[str, ...] = ("output", "input", "frequency")) -> Path:
    """G in MATLAB 5 with its axes in any order."""
    savemat(file, _named(g, axes))
    return file


def mat73(file: Path, g: TransferMatrix, axes: tuple[str, ...] = ("output", "input", "frequency")) -> Path:
    """G as MATLAB writes it in version 7.3: arrays reversed, complex numbers as (real, imag)."""
    with h5py.File(file, "w", userblock_size=512) as content:
        for name, array in _named(g, axes).items():
            stored = array.T
            if np.iscomplexobj(stored):
                pairs = np.empty(stored.shape, dtype=[("real", "<f8"), ("imag", "<f8")])
                pairs["real"], pairs["imag"] = stored.real, stored.imag
                stored = pairs
            content.create_dataset(name, data=stored).attrs["MATLAB_class"] = np.bytes_("double")
    with file.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, made by a lab".ljust(124) + b"\x00\x02IM")
    return file


def _named(g: TransferMatrix, axes: tuple[str, ...]) -> dict[str, Any]:
    order = [AXES.index(a) for a in axes]
    valid = np.isfinite(g.values) if g.valid is None else g.valid
    return {
        "G": np.transpose(g.values, order),
        "valid": np.transpose(valid, order).astype(np.uint8),
        "frequency_Hz": g.frequency[:, None],
    }


def tdms(file: Path, channels: dict[str, Any], rate: float = 1e4, group: str = "sweep", **properties: Any) -> Path:
    """Channels [V] of one group as waveforms."""
    says = {"wf_increment": 1 / rate, "wf_start_offset": 0.0, "unit_string": "V", **properties}
    with TdmsWriter(str(file)) as writer:
        writer.write_segment([ChannelObject(group, n, np.ascontiguousarray(a), properties=says)
                              for n, a in channels.items()])  # fmt: skip
    return file


def sweep_tdms(file: Path, recording: Recording) -> Path:
    """Drive (or loopback) and response of all repeats of a ``recording``."""
    drive = np.tile(recording.sent, len(recording.response))
    channels = {"drive": drive, "response": recording.response.ravel()}
    if recording.loopback is not None:
        channels["loopback"] = recording.loopback.ravel()
    return tdms(file, channels, recording.sample_rate)
