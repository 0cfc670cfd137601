"""The sweep: a greedy reduced model certified on direct solves, or a direct solve per frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import SolverError
from ...progress import Progress, tell
from ...scenario.sweep import ReducedSolve, SolverOptions
from ...store.shelf import Shelf
from ...typing import ComplexArray, FloatArray
from ..assembly.model import ForearmModel
from ..kernels.compiled import give_back
from ..linear.direct import ENOUGH, make_solver
from .affine import AffineReduced, Modes
from .certificate import Certificate, certified, error_at, largest_change
from .expansion import Expander, ReducedSweepState, Snapshots, expansion_frequencies, starts_from_rate
from .widening import lacking_directions, widened

_SHARE = 1e-3  # of what is asked of the reduced model: the residual that its solves are refined to
_UNCERTIFIED = 1e-5  # what the second stage may cost where nothing else is known
_LOSSLESS = 1e-4  # loss factor of every term below which no reduced model is tried
_USELESS = 0.5  # a stated error above this says that the model tells nothing


@dataclass(frozen=True)
class SweepResult:
    """Compliance (n_frequency, n_port, n_port) [m/N] and what certifies it.

    ``residual`` is the largest relative residual of any solve, ``solve_error`` the error of the compliance that it
    causes, relative to the largest watched entry: x_i . r_j, exact to first order as A is symmetric. ``rate``
    [1/s] is where the model started, with so many ``derivatives``; 0 where it started from frequencies.
    ``wider`` serves other moduli (:func:`.widened`).
    """

    values: ComplexArray
    residual: float
    solve_error: float = 0.0
    reduced: AffineReduced | None = None
    expansions: tuple[float, ...] = ()
    certificates: tuple[Certificate, ...] = ()
    poles: Modes | None = None
    compression: float = 0.0
    least: float = 0.0
    solver: str = ""
    rate: float = 0.0
    derivatives: int = 0
    wider: AffineReduced | None = None

    @property
    def factorisations(self) -> int:
        """Number of factorisations of the reduced model, certificates included."""
        compared = (c.frequency for c in self.certificates if c.by != "residual")
        return bool(self.rate) + len({*self.expansions, *compared})

    @property
    def unstable_poles(self) -> int:
        """Poles of the reduced model in the right half-plane, far outside the band: it is good for frequencies there.

        None where all tissue is compressible (:func:`.affine.condensed`).
        """
        return 0 if self.reduced is None else self.reduced.negative_directions()

    @property
    def reduction_error(self) -> float:
        """Error stated for the reduced model by its last certificate.

        ``least``, the tolerance, is stated at least where resonances are sharp, with a bound at every bin, as poles and
        residues, and the solves, have errors of their own; and where the model was compared at a frequency: that it
        keeps the tolerance there tells of others, but not that it errs as little as there. Certificates are of the
        whole space; what the second stage changes (``compression``) comes on top.
        """
        return max(self.certificates[-1].bound, self.least) + self.compression

    def states(self, frequency: FloatArray, ports: Sequence[int]) -> ComplexArray:
        """Reduced solutions (n_frequency, r, n_chosen) for a unit force on the chosen ``ports``, shares undone."""
        if self.poles is not None:
            return self.poles.states(frequency, ports)
        assert self.reduced is not None
        return np.asarray(self.reduced.states(frequency)[:, :, ports] * self.reduced.shares[ports])


def direct_sweep(
    model: ForearmModel, frequency: FloatArray, options: SolverOptions, *, progress: Progress | None = None
) -> SweepResult:
    """Factorise and solve at every frequency (n,) [Hz]."""
    solver = make_solver(model, options, float(frequency[-1]))
    values, residual, error = [], 0.0, 0.0
    for i, f in enumerate(frequency):
        solution = solver.at(float(f))
        values.append(solver.compliance(solution))
        residual, error = max(residual, solution.residual), max(error, solver.solve_error(solution))
        tell(progress, "direct solves", i + 1, len(frequency))
    solver.factor.release()
    return SweepResult(np.array(values), residual, error, solver=solver.factor.name)


def reduced_sweep(
    model: ForearmModel,
    frequency: FloatArray,
    options: ReducedSolve,
    *,
    tolerance: float | None = 1e-4,
    progress: Progress | None = None,
    kept: Shelf | None = None,
    widen: bool = False,
) -> SweepResult:
    """Sweep by a reduced model that is certified between the places it was made from.

    Where all moduli are Kelvin-Voigt and resonances not sharp it starts from derivatives about a real rate
    (``rate_space``), else from ``expansion.expansion_frequencies``. Then its residual at the most doubtful frequency
    (``certificate``) certifies it (``dual``), or where that does not pass a direct solve there: where that true error
    exceeds ``tolerance`` the solution and its derivatives extend it (``max_expansions`` frequencies in all; the
    certificates say what was reached). Solves are refined to a thousandth of ``tolerance``, to 1e-7 at least. Where
    resonances are sharp the model is made in double precision, and a bound at every bin (:mod:`.bounds`) must pass as
    well. With ``tolerance`` None nothing is certified and no factorisation is spent on it. Raises SolverError where
    the stated error is above 0.5. What is ``kept`` of an interrupted sweep is not made again. Asked to ``widen``, it
    makes :attr:`SweepResult.wider`, too.
    """
    _refuse_lossless(model, frequency)
    residual = ENOUGH if tolerance is None else min(ENOUGH, _SHARE * tolerance)
    store = Snapshots(kept)
    work = Expander(model, options, store, residual)
    try:
        made = work.about_rate(frequency, tolerance, progress) if starts_from_rate(model, options) else None
        if made is None:
            made = work.about_frequencies(expansion_frequencies(frequency, options), progress)
        if tolerance is not None:
            made = _certified(work, made, frequency, options, tolerance, progress)
        give_back()  # what certificates worked with
        lacking = lacking_directions(model, made.reduced, frequency, work.inverse(frequency)) if widen else None
        work.release()
        wider = None if lacking is None else widened(model, made.reduced, lacking)
        result = replace(_swept(model, made, frequency, tolerance), solver=work.solver, wider=wider)
    except np.linalg.LinAlgError as problem:
        raise SolverError(
            f"the reduced model breaks down in this band ({problem}); set solver.sweep = 'direct', or give the tissues "
            "more viscosity (tissues.override)"
        ) from None
    finally:
        store.finish()
    if tolerance is not None and result.certificates and result.reduction_error > _USELESS:
        raise SolverError(
            f"the reduced model of {len(result.expansions)} expansion frequencies may be wrong by "
            f"{result.reduction_error:.2g} times G: it does not resolve the resonances of this band; raise "
            "solver.max_expansions, narrow the band, or set solver.sweep = 'direct'"
        )
    return result


def _refuse_lossless(model: ForearmModel, frequency: FloatArray) -> None:
    """Raise SolverError where no term loses a ten-thousandth of what it keeps: peaks are then narrower than any bin."""
    theta = [complex(t.coefficient.at(np.array(2 * np.pi * frequency[-1]))) for t in model.operator.terms]
    loss = max(abs(t.imag) / abs(t) for t in theta if t)
    if loss < _LOSSLESS:
        raise SolverError(
            f"nothing in this scene takes up energy (largest loss factor {loss:.1g}, needed {_LOSSLESS:g}): its "
            "resonances are narrower than any bin; give the tissues viscosity (tissues.override), let supports.ends "
            "absorb, or set solver.sweep = 'direct'"
        )


def _certified(
    work: Expander,
    begun: ReducedSweepState,
    frequency: FloatArray,
    options: ReducedSolve,
    tolerance: float,
    progress: Progress | None,
) -> ReducedSweepState:
    """``begun`` with certificates, and with further expansions until these are good enough or no more are allowed.

    Nor are there more where the model does not reproduce what it was extended by: another would not mend that.
    """
    made, truths = begun, dict[float, ComplexArray]()
    while True:
        used = [e.frequency for e in made.expansions]
        worst = work.most_doubtful(made, frequency)
        if worst is None:
            return made
        tell(progress, "check of the reduced model", len(made.certificates), len(made.certificates) + 1)
        elsewhere = max((error_at(made.reduced, work.model, f, c) for f, c in truths.items()), default=0.0)
        found = work.foreseen(made, worst, tolerance) or work.compared(made, worst, tolerance)
        if found is not None:
            return made.with_certificate(replace(found, elsewhere=elsewhere))
        truth = work.direct(worst.frequency)
        compliance = np.asarray((work.model.functionals.T @ truth.series[0]) * work.model.shares)
        found = replace(certified(made.reduced, work.model, compliance, worst, len(used)), elsewhere=elsewhere)
        made = made.with_certificate(found).after(truth)
        tell(progress, "check of the reduced model", len(made.certificates), len(made.certificates))
        if found.bound <= tolerance or elsewhere > tolerance or len(used) >= options.max_expansions:
            return made
        truths[worst.frequency] = compliance
        made = work.extended(made, worst.frequency, truth)


def _swept(model: ForearmModel, made: ReducedSweepState, frequency: FloatArray, tolerance: float | None) -> SweepResult:
    wary = made.sharp or any(c.wary for c in made.certificates)
    small, change = made.reduced, 0.0
    if not wary and not made.rate:  # derivatives about a rate are few enough, and hold for other moduli too
        most = tolerance or _UNCERTIFIED
        tried = made.reduced.compressed(frequency, drop=max(0.1 * most, 1e-9))  # directions cost about their own size
        changed = largest_change(model, made.reduced, tried, frequency)
        small, change = (tried, changed) if changed <= most else (made.reduced, 0.0)
    fast = small.modes(frequency)
    values = small.compliance(frequency) if fast is None else fast.compliance(frequency)
    return SweepResult(
        values,
        made.residual,
        made.solve_error,
        small,
        tuple(e.frequency for e in made.expansions),
        made.certificates,
        fast,
        change,
        (tolerance or 0.0) if wary or any(c.by != "residual" for c in made.certificates[-1:]) else 0.0,
        rate=made.rate,
        derivatives=made.derivatives,
    )
