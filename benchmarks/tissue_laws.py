"""Joint fit of three tissue laws to what was published of skin, fat and muscle; writes forearm_fem/tissue_laws.json.

    python3 benchmarks/tissue_laws.py

For each law the inputs of questions/predict/priors.toml (tissues, tension, thicknesses, fascia) start from wide
normals; once more for arms without a deep fascia ("bare"), which the presets and scenes without that layer have. DATA
moves them: least squares of the logarithms of data and of the inputs' deviates, and Laplace's covariance about the
best point. Each datum's spread holds people and method, and sources that disagree are data side by side. Data of one
kind and tissue together weigh as much as one of them: what is wanted is the spread of arms and methods, not that of
their mean. Table I and figure A.2 of de Vlam 2022 are not among DATA: they are there to judge by.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from forearm_fem.layered import Disc, Layer, Surface, layered_compliance
from forearm_fem.metrics import fit_waves
from forearm_fem.questions.predict.draws import FASCIA, SOFT, Prior, fascia_parameters, law_parameters, wide_priors
from forearm_fem.tissue import LAWS, Law
from forearm_fem.typing import FloatArray

FILE = Path(__file__).resolve().parents[1] / "forearm_fem" / "tissue_laws.json"
DENSITY, BULK = {"skin": 1100.0, "fat": 950.0, FASCIA: 1120.0, "muscle": 1060.0}, 2.2e9
DRAWS, SEED = 4000, 0


@dataclass(frozen=True)
class Datum:
    """A published ``value``; one deviation is times or divided by ``spread``.

    ``what``: size, storage or loss [Pa] or loss tangent [-] of a tissue's modulus, "wave modulus" rho c^2 [Pa] of a
    plane shear wave, surface "speed" [m/s], or "stiffness" [N/m] of a rigid disc of 0.50 cm^2, at ``frequency`` [Hz].
    """

    what: str
    tissue: str
    frequency: float
    value: float
    spread: float
    source: str

    @property
    def kind(self) -> tuple[str, str]:
        """Data that say the same of the same tissue."""
        return self.tissue, "loss" if self.what.startswith("loss") else self.what if not self.tissue else "stiffness"


DATA = (
    Datum("wave modulus", "skin", 450.0, 13.3e3, 1.5,
          "Feng et al. 2022, arXiv:2201.12258: E of the dermis about 40 kPa at 0.2-1 kHz; the abstract has no spread"),
    Datum("storage", "skin", 300.0, 10.6e3, 1.7,
          "forearm by ultrasound of 40 MHz, five people: 24.90+-6.63 and 13.64+-2.67 kPa along and across; whether "
          "shear or Young's modulus, and the frequency, not seen: middle of both readings"),
    Datum("loss", "skin", 300.0, 6.1e3, 1.6, "the same: 3.23+-0.93 Pa s; the frequency was not seen, 300 Hz taken"),
    Datum("size", "fat", 50.0, 752.0, 1.8, "gluteal fat by MRE, ten people, JMBBM 2023: 752 Pa unloaded"),
    Datum("size", "fat", 90.0, 1610.0, 1.8,
          "fat by MRE at 70-110 Hz, 13 people, Debernard et al. 2013: 1.61+-0.37 kPa"),
    Datum("size", "fat", 90.0, 3040.0, 1.8,
          "thigh's fat by MRE, 29 people, PMC4580449: 3.04+-0.12 kPa; the frequency was not seen, 90 Hz taken"),
    Datum("wave modulus", "fat", 450.0, 5.0e3, 1.8, "Feng et al. 2022: E of the hypodermis about 15 kPa at 0.2-1 kHz"),
    Datum("size", "muscle", 50.0, 1000.0, 2.0, "passive gluteal muscle by MRE, JMBBM 2023: 1000 Pa"),
    Datum("size", "muscle", 50.0, 1557.0, 2.0,
          "relaxed thigh by MRE at 25-62.5 Hz, Klatt et al. 2010: springpot of 2.68+-0.23 kPa, exponent 0.253 "
          "(eta 1 Pa s)"),
    Datum("loss tangent", "muscle", 40.0, math.tan(0.253 * math.pi / 2), 1.3, "the same: exponent 0.253+-0.009"),
    Datum("storage", "muscle", 150.0, 3.7e3, 1.6, "relaxed calf by MRE, Kang et al. 2007: 3.7 kPa"),
    Datum("loss", "muscle", 100.0, 2827.0, 1.4, "the same: 4.5 Pa s at 100 Hz"),
    Datum("loss", "muscle", 200.0, 3016.0, 1.4, "the same: 2.4 Pa s at 200 Hz, so that the loss levels off"),
    Datum("size", "muscle", 90.0, 4.6e3, 1.6,
          "thigh by MRE: 3.67+-0.71 kPa (Debernard et al. 2013, 70-110 Hz), 3.91 to 6.15 kPa (PMC4580449)"),
    Datum("wave modulus", "muscle", 200.0, 19e3, 2.0,
          "muscle by vibrometry, review PMC9631468: 4.0-4.5 m/s; the frequency was not seen, 200 Hz taken"),
    Datum("speed", "", 100.0, 2.76, 1.2,
          "Zhang et al. 2011, 30 forearms: mu 7.86+-1.86 kPa, eta 5.03+-0.60 Pa s of the dispersion from 100 to "
          "400 Hz"),
    Datum("speed", "", 200.0, 3.14, 1.2, "the same; a typical forearm has 3.25+-0.19 m/s at 200 Hz"),
    Datum("speed", "", 300.0, 3.61, 1.2, "the same"),
    Datum("stiffness", "", 20.0, 80.0, 1.8,
          "Sueda 1972: 80 N/m relaxed under 0.50 cm^2; the frequency was not seen"),
)  # fmt: skip
# Zhang's own distances were not seen: 5 to 15 mm from the ball's centre, before the near field shows (physics_data.md
# 2.3).
LINE = tuple(Disc(x, 0.0) for x in np.linspace(5e-3, 15e-3, 5))
BALL, PLATE = Disc(0.0, 0.0, 1.5e-3), Disc(0.0, 0.0, math.sqrt(0.5e-4 / math.pi), "bonded")


def modulus(parameters: Mapping[str, Any]) -> Law:
    """The modulus that a scenario's override would give."""
    p = {key: value for key, value in parameters.items() if key != "law"}
    return LAWS[parameters["law"]](**p)


def predicted(law: str, inputs: Mapping[str, Prior], z: FloatArray) -> FloatArray:
    """What DATA would be for the deviates ``z`` of ``inputs``."""
    values = {name: prior.value(x) for (name, prior), x in zip(inputs.items(), z, strict=True)}
    moduli = {tissue: modulus(p) for tissue, p in law_parameters(law, values).items()}
    if "fascia modulus" in values:
        moduli[FASCIA] = modulus({k: fascia_parameters(values["fascia modulus"])[k] for k in ("law", "mu", "eta")})
    thickness = {t: values[f"{t} thickness"] for t in ("skin", "fat", FASCIA) if t in moduli} | {"muscle": math.inf}
    layers = [Layer(h, DENSITY[t], moduli[t].at, BULK) for t, h in thickness.items()]
    surface = Surface(values["skin tension"])
    band = np.array([100.0, 200.0, 300.0])
    line = layered_compliance(layers, 2 * np.pi * band, [BALL], LINE, surface=surface, tolerance=1e-4).values[:, :, 0]
    speed = dict(zip(band, fit_waves(band, np.array([d.x for d in LINE]), line).speed, strict=True))
    plate = layered_compliance(layers, np.array([2 * np.pi * 20]), [PLATE], [PLATE], surface=surface, tolerance=1e-4)
    stiffness = float((1 / plate.values[0, 0, 0]).real)
    return np.array([_one(d, moduli.get(d.tissue), speed, stiffness) for d in DATA])


def _one(datum: Datum, law: Law | None, speed: Mapping[float, float], stiffness: float) -> float:
    if law is None:
        return speed[datum.frequency] if datum.what == "speed" else stiffness
    value = complex(law.at(2 * np.pi * datum.frequency))
    wave = 1 / (1 / np.sqrt(value)).real ** 2
    known = {"size": abs(value), "storage": value.real, "loss": value.imag, "loss tangent": value.imag / value.real}
    return float({**known, "wave modulus": wave}[datum.what])


def fitted(law: str, *, bare: bool) -> dict[str, Any]:
    """Mean, covariance and what became of each datum, on arms with a deep fascia or (``bare``) without one."""
    inputs = wide_priors().tissue_inputs(law, bare)
    target = np.log([d.value for d in DATA])
    spread = np.log([d.spread for d in DATA]) * np.sqrt([sum(e.kind == d.kind for e in DATA) for d in DATA])

    def misfit(z: FloatArray) -> FloatArray:
        """What is predicted less what was published, in their spreads, then the normal scores."""
        return np.concatenate([(np.log(predicted(law, inputs, z)) - target) / spread, z])

    best = least_squares(misfit, np.zeros(len(inputs)), diff_step=1e-3, x_scale=1.0, xtol=1e-6, ftol=1e-6)
    covariance = np.linalg.inv(best.jac.T @ best.jac)
    band = np.exp([np.quantile(row, [0.05, 0.5, 0.95]) for row in _spread(law, inputs, best.x, covariance)])
    return {
        "names": list(inputs),
        "mean": _rounded(best.x),
        "covariance": [_rounded(row) for row in (covariance + covariance.T) / 2],
        "misfit": float(np.sqrt(np.mean((best.fun[: len(DATA)] * spread / np.log([d.spread for d in DATA])) ** 2))),
        "tissues": _presets(law, inputs, best.x, covariance),
        "data": [_account(d, *row) for d, row in zip(DATA, band, strict=True)],
    }


def _spread(law: str, inputs: Mapping[str, Prior], mean: FloatArray, covariance: FloatArray) -> FloatArray:
    """Logarithms of DATA (n_data, n) over draws."""
    z = np.random.default_rng(SEED).multivariate_normal(mean, covariance, 200)
    return np.log([predicted(law, inputs, row) for row in z]).T


def _presets(law: str, inputs: Mapping[str, Prior], mean: FloatArray, covariance: FloatArray) -> dict[str, Any]:
    """Value at the best point, x/÷ spread and 90 % range over draws, of each tissue parameter."""
    z = np.random.default_rng(SEED).multivariate_normal(mean, covariance, DRAWS)

    def parameters(row: FloatArray) -> dict[str, dict[str, Any]]:
        """The law's parameters by tissue from normal scores."""
        return law_parameters(law, {n: p.value(x) for (n, p), x in zip(inputs.items(), row, strict=True)})

    centre, drawn = parameters(mean), [parameters(row) for row in z]
    out: dict[str, Any] = {}
    for tissue in SOFT:
        out[tissue] = {}
        for key in (k for k in centre[tissue] if k != "law"):
            logs = np.log([d[tissue][key] for d in drawn])
            low, high = np.exp(np.quantile(logs, [0.05, 0.95]))
            numbers = {"value": centre[tissue][key], "low": low, "high": high, "spread": math.exp(float(np.std(logs)))}
            out[tissue][key] = {name: float(f"{number:.4g}") for name, number in numbers.items()}
    return out


def _account(datum: Datum, low: float, median: float, high: float) -> dict[str, Any]:
    where = {"what": datum.what, "tissue": datum.tissue, "frequency": datum.frequency, "source": datum.source}
    numbers = {"measured": datum.value, "spread": datum.spread, "low": low, "median": median, "high": high}
    return {**where, **{name: float(f"{number:.4g}") for name, number in numbers.items()}}


def _rounded(row: FloatArray) -> list[float]:
    return [float(f"{x:.6g}") for x in row]


def main() -> None:
    """Fit the laws, print how well each datum is met, and store the reference."""
    both = {part: {law: fitted(law, bare=part == "bare") for law in wide_priors().laws} for part in ("laws", "bare")}
    content = json.dumps({"made_by": "benchmarks/tissue_laws.py", **both}, indent=1)
    FILE.write_text(content + "\n", encoding="utf-8")
    for name, found in ((f"{law}, {part}", each) for part, laws in both.items() for law, each in laws.items()):
        print(f"{name}: rms misfit {found['misfit']:.2f} deviations")
        for d in found["data"]:
            print(f"  {d['what']:13} {d['tissue']:7} {d['frequency']:5.0f} Hz  measured {d['measured']:8.4g}"
                  f" x/÷ {d['spread']:.1f}  fitted {d['median']:8.4g} ({d['low']:.4g}-{d['high']:.4g})")  # fmt: skip
        for tissue, keys in found["tissues"].items():
            print(f"  {tissue}: " + ", ".join(f"{k} {v['value']:.4g} x/÷ {v['spread']:.2f}" for k, v in keys.items()))


if __name__ == "__main__":
    sys.exit(main())
