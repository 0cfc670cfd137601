"""Error estimates: made of e(f), and held against the accuracy asked for."""

from __future__ import annotations

import math

from ..scenario import Scenario
from ..transfer import ErrorEstimate, total_error
from ..typing import FloatArray


def quadrature_estimate(frequency: FloatArray, error: FloatArray, method: str) -> ErrorEstimate:
    """Error of the layered model's integrals and series: e(f) ``error`` (n,) at ``frequency`` (n,) [Hz].

    Its band value is the largest, as these errors are alike over the band.
    """
    return ErrorEstimate("quadrature", float(error.max()), method, tuple(frequency.tolist()), tuple(error.tolist()))


def accuracy_verdict(scenario: Scenario, errors: tuple[ErrorEstimate, ...]) -> str:
    """One sentence: was the accuracy asked for met, by the estimates? Unknown where one of them could not be made, and
    for a measured G, which states its scatter alone."""
    if not errors:
        return "no error estimate was made, so the accuracy asked for cannot be confirmed"
    asked, total = f"asked e_band <= {scenario.accuracy:g}", total_error(errors)
    if math.isnan(total):
        missing = [e for e in errors if not e.known]
        names = ", ".join(e.source for e in missing)
        return f"{asked}: UNKNOWN, as {names} could not be estimated ({missing[0].method})"
    if all(e.source == "measurement" for e in errors):
        return f"{asked}: UNKNOWN, as a measured G states its scatter ({total:.2g}) and no systematic error"
    met = "met" if total <= scenario.accuracy else "NOT met"
    return f"{asked}, estimated {total:.2g} over all sources: {met}"


def short_verdict(sentence: str) -> str:
    """The verdict in a :func:`accuracy_verdict`, for a table: met, NOT met, or UNKNOWN, also where there is none."""
    return next((word for word in ("UNKNOWN", "NOT met", "met") if word in sentence), "UNKNOWN")
