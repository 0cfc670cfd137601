"""From a law's drawn inputs to the tissue parameters of a scenario."""

from __future__ import annotations

import math
from collections.abc import Mapping

SOFT = ("skin", "fat", "muscle")
REFERENCE = 150.0  # Hz at which the size of a springpot's modulus is stated


def law_parameters(law: str, values: Mapping[str, float]) -> dict[str, dict[str, float | str]]:
    """Keys of ``[tissues.override.T]`` for T = skin, fat and muscle from inputs named "T.input".

    kelvin-voigt: mu [Pa], eta [Pa s]. zener: mu, stiffening mu_infinity/mu - 1, relaxation 1/(2 pi tau) [Hz].
    springpot: size |mu*| [Pa] at 150 Hz, and exponent; its eta is 1 Pa s.
    """
    return {tissue: {"model": law, **_parameters(law, tissue, values)} for tissue in SOFT}


def _parameters(law: str, tissue: str, values: Mapping[str, float]) -> dict[str, float]:
    if law == "kelvin-voigt":
        return {"mu": values[f"{tissue}.mu"], "eta": values[f"{tissue}.eta"]}
    if law == "zener":
        mu, rise = values[f"{tissue}.mu"], values[f"{tissue}.mu"] * values[f"{tissue}.stiffening"]
        eta = rise / (2 * math.pi * values[f"{tissue}.relaxation"])
        return {"mu": mu, "mu_infinity": mu + rise, "eta": eta}
    exponent = values[f"{tissue}.exponent"]
    size = values[f"{tissue}.size"] / (2 * math.pi * REFERENCE) ** exponent
    return {"mu": size ** (1 / (1 - exponent)), "exponent": exponent, "eta": 1.0}
