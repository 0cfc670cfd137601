"""Terms by which the operator follows layers of another thickness: constant matrices times powers of stretch.

In a flat layer that is s times as thick derivatives along the normal are 1/s of what they were, and volumes s times:
stiffness is s K_t + K_c + K_n / s, mass s M, divergence s B_t + B_n, exactly. Where layers bend, the section's radius
enters too: a few more powers, and of how much deeper the layer lies, fitted to matrices of meshes that were moved.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ...errors import GeometryError
from ...geometry.device.layout import layers_of
from ...geometry.limb.thickness import Stretch, stretched, stretches, unfolded
from ...geometry.mesh.tissue_mesh import TissueMesh
from ...scenario.limb import Limb, SlabLimb
from ...typing import FloatArray

Powers = tuple[tuple[int, int], ...]  # of scale and offset
_FLAT: Mapping[str, Powers] = dict.fromkeys(("shear", "fibres"), ((1, 0), (-1, 0)))
_FLAT_OTHERS: Powers = ((1, 0),)
_BENT: Mapping[str, Powers] = {
    **dict.fromkeys(("shear", "fibres"), ((1, 0), (-1, 0), (2, 0), (0, 1), (1, 1), (-1, 1))),
    "incompressibility": ((1, 0), (2, 0), (0, 1), (1, 1)),
}
_BENT_OTHERS: Powers = ((1, 0), (2, 0), (1, 1))
_CORE: Powers = ((0, 1), (0, 2), (0, 3))
_MARK = "; "  # between a term's name and its powers


@dataclass(frozen=True, eq=False)
class Motion:
    """A ``mesh``, its ``meshes`` whose layers are of other thicknesses, with the ``stretches`` of each; ``bent`` where
    layers are, about a ``core``."""

    mesh: TissueMesh
    meshes: tuple[TissueMesh, ...]
    stretches: tuple[Mapping[str, Stretch], ...]
    bent: bool
    core: str

    def powers(self, kind: str, tissue: str) -> Powers:
        """Powers of the terms of a ``kind`` that a ``tissue`` needs beside the one of the mesh itself."""
        if not self.bent:
            return _FLAT.get(kind, _FLAT_OTHERS)
        found = _CORE if tissue == self.core else _BENT.get(kind, _BENT_OTHERS)
        deep = any(s[tissue].offset for s in self.stretches)
        return tuple(p for p in found if deep or not p[1])


def factor(powers: tuple[int, int], stretch: Stretch) -> float:
    """scale^a offset^b, less what it is on the mesh itself."""
    a, b = powers
    return float(stretch.scale**a * stretch.offset**b) - (b == 0)


def marked(name: str, powers: tuple[int, int]) -> str:
    """Name of a term such as "shear fat; -1 0"."""
    return f"{name}{_MARK}{powers[0]} {powers[1]}"


def unmarked(name: str) -> tuple[str, tuple[int, int] | None]:
    """The name without powers, and these; None where it has none."""
    base, _, powers = name.partition(_MARK)
    if not powers:
        return base, None
    a, b = powers.split()
    return base, (int(a), int(b))


def follows_thickness(names: Sequence[str]) -> bool:
    """True if there are such terms among the ``names``."""
    return any(_MARK in name for name in names)


def thickness_terms(
    motion: Motion, own: Mapping[str, csr_array], other: Callable[[TissueMesh], Mapping[str, csr_array]]
) -> dict[str, csr_array]:
    """Matrices of the terms beside the mesh's ``own`` ones, which ``other`` gives for a moved mesh, by name.

    Least squares over all meshes, entry by entry.
    """
    fits = dict[str, tuple[Powers, FloatArray]]()
    for name in own:
        kind, _, tissue = name.partition(" ")
        if tissue not in motion.stretches[0]:  # bones
            continue
        powers = motion.powers(kind, tissue)
        table = np.array([[factor(p, s[tissue]) for p in powers] for s in motion.stretches])
        size = np.abs(table).max(axis=0)
        size[size == 0] = 1.0  # a layer that no mesh changes
        fits[name] = powers, np.linalg.pinv(table / size) / size[:, None]
    found = dict[str, csr_array]()
    for j, mesh in enumerate(motion.meshes):
        for name, matrix in other(mesh).items():
            if name not in fits:
                continue
            powers, weights = fits[name]
            change = _less(matrix, own[name])
            for power, weight in zip(powers, weights[:, j].tolist(), strict=True):
                place = marked(name, power)
                found[place] = _plus(found[place], weight, change) if place in found else weight * change
    return found


def _same(one: csr_array, other: csr_array) -> bool:
    return one.nnz == other.nnz and np.array_equal(one.indices, other.indices)


def _less(one: csr_array, other: csr_array) -> csr_array:
    """Difference on the pattern of both, zeros kept where it is the same."""
    if _same(one, other):
        return csr_array((one.data - other.data, one.indices, one.indptr), shape=one.shape)
    return csr_array(one - other)


def _plus(total: csr_array, weight: float, change: csr_array) -> csr_array:
    if _same(total, change):
        total.data += weight * change.data
        return total
    return csr_array(total + weight * change)


_SAMPLES = 8  # meshes that bent layers are fitted to, beside the ends: two thirds more than the powers of one term


def motion_of(mesh: TissueMesh, limb: Limb, others: Sequence[Limb]) -> Motion | None:
    """Meshes over the thicknesses of ``others``, made of a ``mesh`` of ``limb``; None where all have its own.

    Flat layers take two, which is exact.
    """
    inside = np.array([[layer.thickness for layer in layers_of(each)] for each in (limb, *others)])
    low, high = inside.min(axis=0), inside.max(axis=0)
    if np.allclose(low, high, rtol=1e-9):
        return None
    from scipy.stats import qmc  # half a second, which no other run needs

    ends, flat = np.outer([0.0, 1.0], np.ones(len(low))), isinstance(limb, SlabLimb)
    places = ends if flat else np.vstack([ends, qmc.LatinHypercube(len(low), rng=0).random(_SAMPLES)])
    ways, limbs = list[Mapping[str, Stretch]](), list[Limb]()
    for sample in low * (high / low) ** places:
        layers = [layer.changed({"thickness": t}) for layer, t in zip(layers_of(limb), sample.tolist(), strict=True)]
        other = limb.changed({"layers": layers})
        if (way := stretches(limb, other)) is None:
            return None
        try:
            stretched(mesh, limb, other)
        except GeometryError:  # thick layers all at once
            continue
        ways.append(way)
        limbs.append(other)
    mesh = unfolded(mesh, limb, limbs)
    meshes = tuple(stretched(mesh, limb, each) for each in limbs)
    return Motion(mesh, meshes, tuple(ways), not flat, str(getattr(limb, "core", "")))
