"""One mesh's part of a library: one factorisation, a space for all loads on the patch, poles; kept as it goes."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.sparse import csr_array

from ...errors import SolverError
from ...fem.assembly.coefficients import Polynomial, is_polynomial
from ...fem.assembly.model import ForearmModel
from ...fem.kernels.compiled import freed_memory_kept
from ...fem.linear.direct import make_solver
from ...fem.reduction.affine import AffineReduced, Modes, with_columns
from ...fem.reduction.expansion import expansion_rate
from ...fem.reduction.rate_space import LoadSpace
from ...geometry.build import cached_mesh
from ...layered.response import chebyshev_between, chebyshev_nodes
from ...progress import Progress, tell, within
from ...scenario import Scenario
from ...scenario.sweep import frequencies
from ...store.folder import default_cache_dir
from ...store.record import dims
from ...store.shelf import Shelf
from ...store.text import digest_of
from ...typing import BoolArray, ComplexArray, FloatArray, IntArray
from ..fem import fem_model
from .skin import FlatSkin, GaussianLoads, bell_functionals

# Discs that are held sideways: what they take from the motion of the limb, and from its uncertainty.
# Bonded discs move along the normal only. On discs let go, with forces :math:`f_t` along the skin,
# :math:`u_t=C_{tz}f_z+C_{tt}f_t=0` holds them, so that
# .. math:: C=C_{zz}+B\,C_{tz}=C_{zz}-C_{zt}C_{tt}^{-1}C_{tz},\quad B=-C_{zt}C_{tt}^{-1}.
# A small change of the free compliance changes it by :math:`[I\;B]\,\delta C\,[I\;B]^T`.


def constrained_compliance(free: ComplexArray, n: int) -> tuple[ComplexArray, ComplexArray]:
    """Compliance (n_frequency, n, n) [m/N] where all but the first ``n`` directions of ``free`` (n_frequency, m, m) are
    held, symmetric; and B (n_frequency, n, m - n)."""
    motion = free[:, n:, :n]
    forces = np.linalg.solve(free[:, n:, n:], motion)
    taken = motion.swapaxes(1, 2) @ forces
    return free[:, :n, :n] - 0.5 * (taken + taken.swapaxes(1, 2)), np.asarray(-forces.swapaxes(1, 2))


def deviation_held(deviation: FloatArray, hold: ComplexArray) -> FloatArray:
    """Standard deviation (n_frequency, n, n) [m/N] where those of ``free``, (n_frequency, m, m), are independent."""
    n = hold.shape[1]
    share, squared = np.abs(hold) ** 2, deviation**2
    both = share @ squared[:, n:, :n]
    total = squared[:, :n, :n] + both + both.swapaxes(1, 2) + share @ squared[:, n:, n:] @ share.swapaxes(1, 2)
    return np.asarray(np.sqrt(total))


# The limb as bells on its skin see it: poles and residues.

_DEGREE = 12  # of the Chebyshev rule that carries what far poles add up to
_FAR = 3.5  # half axes of a pole's Bernstein ellipse from which it is far: 3.5^-12 is 3e-7
_NUMBERS = 2**18  # of the residues of some poles that are held side by side: four megabytes stay in the cache


def modal_compliance(
    limb: Modes, frequency: FloatArray, weights: FloatArray, wanted: BoolArray | None = None
) -> ComplexArray:
    """Compliance (n_frequency, p, p) of p combinations ``weights`` (n, p) of the limb's bells; of those ``wanted`` (p,
    p), or all, others are zero.

    Poles far from the band asked for are summed at the nodes of a Chebyshev rule, near ones at every frequency.
    """
    p = weights.shape[1]
    i, j = np.nonzero(np.triu(np.ones((p, p), dtype=bool) if wanted is None else wanted | wanted.T))
    poles, modes = limb.half
    seen, omega, paired = real_product(weights.T, modes), 2 * np.pi * frequency, poles.imag > 0
    near, ends = _near(poles, omega), (float(omega.min()), float(omega.max()))
    some = len(omega) > 2 * _DEGREE
    at = 1j * (chebyshev_nodes(*ends, _DEGREE) if some else omega)
    own = np.where((near & some)[:, None], 0.0, 1 / (at - poles[:, None]))
    values = _summed(seen, i, j, own, paired[:, None] / (at - poles[:, None].conj()))
    if some:
        values = chebyshev_between(*ends, omega, values)[0]
        values += _summed(seen[:, near], i, j, 1 / (1j * omega - poles[near, None]))
    whole = np.zeros((len(omega), p, p), dtype=complex)
    whole[:, i, j] = whole[:, j, i] = values
    return whole


def _near(poles: ComplexArray, omega: FloatArray) -> BoolArray:
    """True where ``poles`` (m,) [1/s] keep a Chebyshev rule in the root of ``omega`` [rad/s] from converging."""
    low, high = np.sqrt(omega.min()), np.sqrt(omega.max())
    if not high > low:
        return np.zeros(len(poles), dtype=bool)
    root = np.sqrt(poles / 1j)
    x = (2 * np.stack([root, -root]) - low - high) / (high - low)
    beside = np.sqrt(x * x - 1)
    return np.asarray((np.maximum(np.abs(x + beside), np.abs(x - beside)) < _FAR).any(axis=0))


def _summed(
    seen: ComplexArray, i: IntArray, j: IntArray, own: ComplexArray, mirrored: ComplexArray | float = 0.0
) -> ComplexArray:
    """Sums (n, pairs) over poles k of r ``own`` (m, n) + conj(r) ``mirrored`` (m, n), r = ``seen``_ik ``seen``_jk.

    As a product of real numbers: Re r (own + mirrored) + Im r i (own - mirrored).
    """
    n = own.shape[1]
    factors = np.stack([own + mirrored, 1j * (own - mirrored)], axis=1)
    total, step = np.zeros((len(i), 2 * n)), max(8, _NUMBERS // max(1, len(i)))
    for start in range(0, seen.shape[1], step):
        some = seen[:, start : start + step]
        factor = factors[start : start + step].reshape(-1, n)
        total += (some[i] * some[j]).view(float) @ factor.view(float)
    return np.asarray(total.view(complex).T)


def real_product(some: FloatArray, others: ComplexArray) -> ComplexArray:
    """``some`` (p, n) times ``others`` (..., n, m) without making the first complex."""
    return np.asarray((some @ others.view(float)).view(complex))


# One mesh's part of a library: one factorisation, a space for all loads on the patch, poles; kept as it goes.

_MAKING = 5  # raise when the same question would give another part
_DROP, _ORDERS = 1e-2, 30  # of directions of the space, and derivatives at most
_SIDEWAYS_DROP = 3e-2  # of those that loads along the skin add: what discs held sideways take is a correction
_FASTER = 2.5  # than the band's middle: high frequencies are what a space cut at _DROP leaves out
_AT_ONCE = 48  # loads
_WITNESSES = 24  # loads of the direct solve that the reduced model is compared with
_CHECKED = (0.0, 0.1, 0.5, 0.75, 1.0)  # of the band: far fields fall with frequency, so that its end is the hardest
_APART = 4  # widths between bells from which their compliance counts there
BIN = 5e-3  # [m] of distance in which errors are taken as alike


@dataclass(frozen=True)
class LoadedSkin:
    """The ``bells`` on a limb's ``skin`` laid flat, the first ``normal`` of them along its normal, others along it."""

    skin: FlatSkin
    bells: GaussianLoads
    normal: int

    @property
    def bins(self) -> FloatArray:
        """Distances (n_bin,) [m] by which errors are told apart, the farthest between two loads among them."""
        farthest = float(np.linalg.norm(np.ptp(self.bells.centres, axis=0)))
        return np.arange(0.0, farthest + BIN, BIN)

    @property
    def batches(self) -> list[tuple[IntArray, float]]:
        """Loads solved at once, and the share of a direction below which theirs are taken as known.

        Each batch is spread over the patch; those along the normal come first.
        """
        out: list[tuple[IntArray, float]] = []
        for first, last, drop in ((0, self.normal, _DROP), (self.normal, len(self.bells.centres), _SIDEWAYS_DROP)):
            order = first + np.argsort((np.arange(last - first) * 0.6180339887498949) % 1.0)
            out += [(order[start : start + _AT_ONCE], drop) for start in range(0, len(order), _AT_ONCE)]
        return out


@dataclass(frozen=True, eq=False)
class MeshPart:
    """One mesh's part: the limb through the bells, with free ends where it has absorbing ones, ``reduction`` (3, n),
    frequencies [Hz] and the reduced model's errors there along the normal and along the skin, ``missed`` (n, 3, n_bin)
    [m/N], what they are by distance, and facts."""

    kind: ClassVar[str] = "part of a library"
    version: ClassVar[int] = 2

    limb: Modes
    freed: Modes | None
    reduction: FloatArray = field(metadata=dims("frequency_and_errors checked"))
    missed: FloatArray = field(metadata=dims("checked direction bin"))
    facts: Mapping[str, Any]


def solved_side(
    meshed: Scenario, loaded: LoadedSkin, base: Path, scale: float = 1.0, progress: Progress | None = None
) -> MeshPart:
    """The part of the mesh of ``meshed`` with sizes times ``scale``; only at scale 1 with freed ends and an error.

    What is done is kept in the cache, and found there.
    """
    began = time.monotonic()
    mesh = cached_mesh(meshed, base=base, scale=scale, progress=within(progress, "mesh"))
    frequency = frequencies(meshed.sweep)
    home, key = default_cache_dir() / "library-parts", _key(meshed, mesh.digest, loaded, scale)
    shelf = Shelf(home / f"{key}.sqlite", "a part of the library")
    kept = Shelf(home / f"{key}-space.sqlite", "what was solved for the library")
    if (found := shelf.record("side", MeshPart)) is not None:
        return found
    tell(progress, "assembly", 0, 1)
    model = fem_model(meshed, mesh)
    seen = bell_functionals(model, loaded.skin, loaded.bells)
    tell(progress, "assembly", 1, 1)
    seconds = time.monotonic() - began
    with freed_memory_kept():  # as long as the columns live: poles and direct solves come to gigabytes of their own
        reduced, facts = _spanned(meshed, model, seen, loaded, frequency, kept, progress)
    side = _finished(meshed, model, seen, reduced, loaded, frequency, whole=scale == 1.0, progress=progress)
    side = replace(side, facts={**facts, **side.facts, "seconds_model": seconds})
    if shelf.keep("side", side):
        kept.remove()
    return side


def _key(meshed: Scenario, mesh: str, loaded: LoadedSkin, scale: float) -> str:
    """SHA-256 of all that a part depends on: not the disc's radius, the grid or the renderers."""
    asked = meshed.model_dump(mode="json", exclude={"name", "description", "rendering"})
    loads = [loaded.bells.width, loaded.bells.centres.tolist(), loaded.normal]
    parts = [_MAKING, asked, mesh, scale, *loads, _DROP, _SIDEWAYS_DROP, _ORDERS, _FASTER]
    return digest_of(parts)[:32]


def _spanned(
    meshed: Scenario,
    model: ForearmModel,
    seen: csr_array,
    loaded: LoadedSkin,
    frequency: FloatArray,
    kept: Shelf,
    progress: Progress | None,
) -> tuple[AffineReduced, dict[str, Any]]:
    """The limb in the space of all loads, each an output, too; batch by batch, from where it was left. And facts.

    Without its columns: they are gigabytes, and direct solves come next.
    """
    assert all(is_polynomial(t.coefficient) for t in model.operator.terms)
    bare = replace(model, ports=(), functionals=np.zeros((model.operator.n, 0)), shares=np.zeros(0))
    total = seen.shape[1]
    empty = replace(AffineReduced.of(bare), functionals=np.zeros((0, total)), shares=np.ones(total))
    reduced, kept_facts = empty.restored(kept) or (empty, {})
    facts = {name: kept_facts.get(name, 0) for name in ("done", "solves", "seconds_loads")}
    tell(progress, "loads on the patch", facts["done"], total)
    if facts["done"] < total:
        began = time.monotonic() - facts["seconds_loads"]
        solver = make_solver(bare, meshed.solver, float(frequency[-1]))
        rate = _FASTER * expansion_rate(frequency, upwards=0.5)
        space = LoadSpace(solver, rate, derivatives=_ORDERS, basis=reduced.basis)
        done, solves = 0, facts["solves"]
        for chosen, drop in loaded.batches:
            done += len(chosen)
            if done <= facts["done"]:
                continue
            block = space.add(seen[:, chosen].toarray(), drop)
            if block.shape[1]:
                reduced = with_columns(reduced, bare, block, np.zeros((reduced.size + block.shape[1], 0)), seen)
            facts = {"done": done, "solves": solves + space.solves, "seconds_loads": time.monotonic() - began}
            reduced.keep(kept, **facts)
            tell(progress, "loads on the patch", done, total)
        solver.factor.release()
    return reduced.bare(), {name: facts[name] for name in ("solves", "seconds_loads")}


def _finished(
    meshed: Scenario,
    model: ForearmModel,
    seen: csr_array,
    reduced: AffineReduced,
    loaded: LoadedSkin,
    frequency: FloatArray,
    *,
    whole: bool,
    progress: Progress | None,
) -> MeshPart:
    """Poles and residues, those with free ends, and the error against direct solves."""
    names = [n for n in reduced.names if n.startswith("dashpots")] if whole else []
    steps, began = 1 + bool(names) + whole, time.monotonic()
    tell(progress, "poles", 0, steps)
    limb, freed = _poles(reduced, frequency), None
    tell(progress, "poles", 1, steps)
    if names:
        freed = _poles(reduced.changed(dict.fromkeys(names, Polynomial())), frequency)
        tell(progress, "poles", 2, steps)
    poles = time.monotonic() - began
    checked = _checked(frequency)
    off, missed = np.full((2, len(checked)), np.nan), np.zeros((len(checked), 3, len(loaded.bins)))
    if whole:
        off, missed = _reduction_error(meshed, model, seen, limb, loaded, frequency)
    tell(progress, "poles", steps, steps)
    facts: dict[str, Any] = {
        "loads": seen.shape[1], "size": reduced.size, "unknowns": model.operator.n,
        "seconds_poles": poles, "seconds_check": time.monotonic() - began - poles,
    }  # fmt: skip
    return MeshPart(limb, freed, np.stack([checked, *off]), missed, facts)


def _poles(reduced: AffineReduced, frequency: FloatArray) -> Modes:
    found = reduced.modes(frequency)
    if found is None:
        raise SolverError(
            "the poles of the library's reduced model are inaccurate; choose a larger library.step, or another band"
        )
    return replace(found, shapes=None)


def _checked(frequency: FloatArray) -> FloatArray:
    """Frequencies (n,) [Hz] of direct solves, rising."""
    return np.asarray(frequency[np.unique([round(share * (len(frequency) - 1)) for share in _CHECKED])])


def _reduction_error(
    meshed: Scenario,
    model: ForearmModel,
    seen: csr_array,
    limb: Modes,
    loaded: LoadedSkin,
    frequency: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Reduction error of the limb's poles between some Gaussian loads, against direct solves at each frequency
    checked.

    The largest over the largest compliance between bells some widths apart (2, n), of those along the normal and of
    those along the skin (NaN without); and :func:`_farther` (n, 3, n_bin) [m/N].
    """
    bells, groups = loaded.bells, (np.arange(loaded.normal), np.arange(loaded.normal, len(loaded.bells.centres)))
    spread = [of[np.unique(np.linspace(0, len(of) - 1, _WITNESSES).astype(int))] for of in groups if len(of)]
    some = np.concatenate(spread)
    chosen = np.asarray(seen[:, some].toarray())
    witness = replace(model, functionals=chosen, shares=np.ones(len(some)))
    away = np.linalg.norm(bells.centres[some][:, None] - bells.centres[some][None], axis=2)
    sideways = (some >= loaded.normal).astype(int)
    kind, far = sideways[:, None] + sideways, away > _APART * bells.width
    checked = _checked(frequency)
    off, missed = np.full((2, len(checked)), np.nan), np.zeros((len(checked), 3, len(loaded.bins)))
    solver = make_solver(model, meshed.solver, float(frequency[-1]))
    for k, at in enumerate(checked):
        truth = chosen.T @ replace(solver, model=witness).at(float(at)).values
        apart = np.abs(modal_compliance(limb, np.array([at]), np.eye(len(bells.centres))[:, some])[0] - truth)
        for group, one in enumerate((0, 2)[: len(spread)]):
            mine = far & (kind == one)
            off[group, k] = apart[mine].max() / np.abs(truth)[mine].max()
        missed[k] = [_farther(apart[kind == one], away[kind == one], loaded.bins) for one in range(3)]
    solver.factor.release()
    return off, missed


def _farther(apart: FloatArray, away: FloatArray, bins: FloatArray) -> FloatArray:
    """The largest of ``apart`` (n,) at each distance (n_bin,) [m] of ``bins`` or farther, of pairs ``away`` (n,) [m];
    beyond the farthest pair, what that one has. Zero without pairs.

    A space that drops a hundredth of fields as strong as those under their loads may miss all of one far away.
    """
    number = np.minimum(np.rint(away / BIN).astype(int), len(bins) - 1)
    largest = np.zeros(len(bins))
    np.maximum.at(largest, number, apart)
    largest = np.maximum.accumulate(largest[::-1])[::-1]
    return np.asarray(largest[np.minimum(np.arange(len(bins)), number.max(initial=0))])
