"""Quarter slabs for finite elements against the layered model: reference scenes, mesh levels, the estimate's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from forearm_fem.accuracy.discretisation import estimated_errors, order_of, remaining_error
from forearm_fem.engines.fem import second_mesh
from forearm_fem.geometry.build import cached_mesh
from forearm_fem.layered import Disc, layered_compliance
from forearm_fem.scenario import Scenario
from forearm_fem.transfer import band_error
from forearm_fem.typing import ComplexArray
from forearm_fem.verification.layered import PRESET_O, miller_pursey
from forearm_fem.verification.scenes import RADIUS, layered_truth, quarter_slab, slab_model, slab_response

LAYERS_O = (("skin", 1.2e-3), ("fat", 3.0e-3))
RADII = (0.010, 0.020, 0.0318)
EPIDERMIS = {"density": 1100.0, "mu": 350e3, "eta": 20.0, "bulk": 2.2e9}
MEMBRANE = {"stiffness": 28.0, "viscosity": 1.6e-3, "mass": 0.088}  # 80 um of it


@dataclass(frozen=True)
class Slab:
    """A square quarter slab for one frequency: ``side``, ``depth``, ``grid`` and ``far`` sizes [m]."""

    preset: str
    frequency: float
    side: float
    depth: float
    grid: float
    far: float
    radii: tuple[float, ...] = RADII
    contact: float = 1.1e-3
    element: str = "P2"
    grading: float = 0.3
    sublayers: tuple[tuple[str, int], ...] = ()  # element layers through tissues, where sizes alone leave too few
    epidermis: Literal["none", "layer", "membrane"] = "none"  # 80 um; the layered model has it either way

    @property
    def scenario(self) -> Scenario:
        """The scenario to mesh."""
        sizes = {
            "size_grid": self.grid,
            "size_contact": self.contact,
            "size_far": self.far,
            "element": self.element,
            "grading": self.grading,
            "sublayers": dict(self.sublayers),
            "min_quality": 1e-5 if self.epidermis == "layer" else 2e-3,  # columns keep their width all the way down
        }
        layers = LAYERS_O if self.preset == "default" else ()
        return quarter_slab(
            self.radii, side=self.side, depth=self.depth, preset=self.preset, mesh=sizes,
            layers=(("epidermis", 8e-5), *layers) if self.epidermis == "layer" else layers,
            frequencies=(self.frequency,), override={"epidermis": EPIDERMIS} if self.epidermis == "layer" else None,
            membrane=MEMBRANE if self.epidermis == "membrane" else None,
        )  # fmt: skip


def solve_level(slab: Slab, scale: float = 1.0) -> ComplexArray:
    """Values (1 + n_point,) [m/N] on a mesh with every element size multiplied by ``scale``."""
    return np.asarray(slab_response(slab_model(slab.scenario, scale=scale), [slab.frequency])[0])


def exact(slab: Slab) -> ComplexArray:
    """Values of the endless slab (1 + n_point,) [m/N]: Miller and Pursey's integral, or the layered model."""
    if slab.preset == "zhang":
        return miller_pursey(slab.frequency, slab.radii)
    if slab.epidermis != "none":
        omega, disc = np.array([2 * np.pi * slab.frequency]), Disc(0.0, 0.0, RADIUS)
        outputs = [disc, *(Disc(r, 0.0) for r in slab.radii)]
        return np.asarray(layered_compliance(PRESET_O, omega, [disc], outputs, tolerance=1e-8).values[0, :, 0])
    return np.asarray(layered_truth(slab.scenario, [slab.frequency])[0])


def errors_of(found: ComplexArray, truth: ComplexArray) -> tuple[float, float]:
    """Error under the disc (relative to itself) and e(f) over the points (relative to the largest of them)."""
    gap = np.abs(found - truth)
    return float(gap[0] / abs(truth[0])), float(gap[1:].max() / np.abs(truth[1:]).max())


def stated_error(coarse: ComplexArray, fine: ComplexArray) -> float:
    """e(f) of the points, as the pipeline states it for the fine mesh."""
    return float(remaining_error(np.abs(coarse - fine)[1:].max() / np.abs(fine[1:]).max()))


# Each slab is as small as the attenuation at its frequency allows and as fine as its shortest wave needs.
_SIZES = {50.0: (0.4, 0.2, 4e-3, 20e-3), 100.0: (0.24, 0.1, 3e-3, 12e-3), 200.0: (0.14, 0.05, 1.8e-3, 8e-3)}
_THIN = (("skin", 2), ("fat", 5))  # the field at 10 mm is 40 times smaller than under the disc: needs 0.6 mm in depth
_LAST = (0.12, 0.05, 1e-3, 1e-2)
REFERENCE = (
    Slab("zhang", 10.0, 1.6, 0.8, 6e-3, 80e-3),
    *(Slab("zhang", f, *size) for f, size in _SIZES.items()),
    Slab("zhang", 400.0, 0.08, 0.03, 1.2e-3, 5e-3),
    Slab("zhang", 500.0, 0.07, 0.025, 1.1e-3, 4.5e-3),
    *(Slab("default", f, *size) for f, size in _SIZES.items()),
    Slab("default", 400.0, *_LAST, contact=1e-3, grading=0.35, sublayers=_THIN),
    *(Slab("default", f, *size, epidermis="layer") for f, size in _SIZES.items()),
    Slab("default", 400.0, *_LAST, contact=1e-3, grading=0.35, sublayers=_THIN, epidermis="layer"),
    Slab("default", 100.0, *_SIZES[100.0], epidermis="membrane"),  # beyond 100 Hz its thickness shows: 1.2 % at 200 Hz
)


def _name(slab: Slab) -> str:
    if slab.preset == "zhang":
        return "half-space Z"
    return "preset O" + {"none": "", "layer": " and epidermis", "membrane": ", epidermis a membrane"}[slab.epidermis]


CONVERGENCE = Slab("default", 300.0, 0.07, 0.025, 1.3e-3, 5e-3, radii=(0.010, 0.020), contact=0.9e-3)
# At 300 Hz the coarsest mesh has 2.5 elements a wave, which it does not carry: order 4 is seen, and 6.7 times the true
# error stated. That is on the safe side, but says nothing about the estimate where it is one.
LEVELS = replace(CONVERGENCE, frequency=250.0)


@dataclass(frozen=True)
class Effectivity:
    """Estimated and true error of one mesh of one scene: ``band`` over three frequencies, ``single`` is e(f) at one."""

    scene: str
    scale: float
    unknowns: int
    estimated_band: float
    true_band: float
    estimated_single: float
    true_single: float

    @property
    def band(self) -> float:
        """Estimated over true band error; between 0.5 and 5 is asked for."""
        return self.estimated_band / self.true_band

    @property
    def single(self) -> float:
        """Estimated over true e(f) at the middle frequency."""
        return self.estimated_single / self.true_single


SCENES = (
    Slab("zhang", 100.0, 0.24, 0.1, 5e-3, 16e-3),
    Slab("zhang", 200.0, 0.14, 0.05, 3e-3, 8e-3),
    Slab("zhang", 400.0, 0.08, 0.03, 1.9e-3, 5e-3),
    Slab("default", 100.0, 0.24, 0.1, 5e-3, 16e-3),
    Slab("default", 200.0, 0.14, 0.05, 3e-3, 8e-3),
    Slab("default", 400.0, 0.08, 0.03, 1.6e-3, 5e-3),
    Slab("default", 500.0, 0.07, 0.025, 1.6e-3, 5e-3, radii=(0.010, 0.020)),
    Slab("default", 300.0, 0.08, 0.03, 2.4e-3, 6e-3, element="P3"),
    Slab("default", 100.0, 0.24, 0.1, 9e-3, 14e-3, element="P2/P3"),
    Slab("zhang", 200.0, 0.14, 0.05, 6e-3, 8e-3, element="P2/P3"),
    Slab("default", 300.0, 0.08, 0.03, 3.6e-3, 8e-3, element="P2/P3"),
    # had no part in the choice of the estimate's rule
    Slab("zhang", 60.0, 0.36, 0.15, 7e-3, 20e-3),
    Slab("default", 150.0, 0.18, 0.07, 4e-3, 10e-3),
    Slab("zhang", 300.0, 0.1, 0.04, 2.2e-3, 6e-3),
    Slab("default", 200.0, 0.14, 0.05, 5e-3, 8e-3, element="P2/P3"),
    Slab("default", 250.0, 0.1, 0.04, 4.2e-3, 8e-3, element="P2/P3"),
)


def scene_name(slab: Slab) -> str:
    """Name of a scene in the effectivity table."""
    return f"{_name(slab)} {slab.frequency:g} Hz {slab.element}"


_SPREAD = (0.8, 1.0, 1.25)


def effectivities(slabs: Sequence[Slab]) -> Iterator[Effectivity]:
    """Estimated against true error on meshes of each scene, the estimate from the pipeline's second mesh."""
    for slab in slabs:
        band = np.array([slab.frequency * s for s in _SPREAD])
        truth = layered_truth(slab.scenario, band.tolist())[:, 1:]
        for scale in (1.5, 1.0):
            sizes = {name: scale * getattr(slab, name) for name in ("grid", "far", "contact")}
            scenario = replace(slab, **sizes).scenario
            mesh = cached_mesh(scenario)
            second = second_mesh(scenario, mesh, base=Path())
            model = slab_model(scenario, mesh=mesh)
            fine = slab_response(model, band.tolist())[:, 1:]
            coarse = slab_response(slab_model(scenario, mesh=second.mesh), band.tolist())[:, 1:]
            order = order_of(scenario)
            rule = estimated_errors(coarse[:, :, None], fine[:, :, None], band, second.ratio, order)
            true, middle = (
                band_error(fine[:, :, None], truth[:, :, None]),
                float(np.abs(fine[1] - truth[1]).max() / np.abs(truth[1]).max()),
            )
            yield Effectivity(scene_name(slab), scale, model.operator.n, rule.band, true, float(rule.error[1]), middle)
