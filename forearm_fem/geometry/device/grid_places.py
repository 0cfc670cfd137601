"""Where a grid may have been laid: places around each of its points, and how to read between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from ...errors import GeometryError
from ...ports import Port
from ...scenario import Scenario
from ...typing import FloatArray
from ..mesh.tissue_mesh import TissueMesh
from .layout import turned
from .place import landed, skin_of

_REACH = 6e-3  # [m] to each side: 3.6 deviations of a corner of the thesis' grid, shifted and turned as priors have it
_COUNT = 7  # places along each side, 2 mm apart at most
_MOST = 2000  # places in all: their rows are kept with a model
_PLANES = ("symmetry x", "symmetry y")


@dataclass(frozen=True)
class GridPlaces:
    """A square of side 2 ``reach`` [m] around each of the ``centres`` (n, 2) [m] in the device's frame, with ``count``
    Chebyshev points along each side."""

    centres: tuple[tuple[float, float], ...]
    reach: float = _REACH
    count: int = _COUNT

    @property
    def places(self) -> FloatArray:
        """All places (n count^2, 2) [m] in the device's frame, those of the first centre first, along y first."""
        x, y = np.meshgrid(self._nodes, self._nodes, indexing="ij")
        around = self.reach * np.column_stack([x.ravel(), y.ravel()])
        return np.asarray((np.array(self.centres)[:, None] + around).reshape(-1, 2))

    def hold(self, scenario: Scenario) -> bool:
        """Whether each point of a ``scenario``'s grid lies in the square of the centre of its number."""
        apart = self._apart(scenario)
        return apart is not None and bool(np.abs(apart).max() <= 1 + 1e-9)

    def shares(self, scenario: Scenario, degree: int) -> FloatArray:
        """Weights (n, count^2) of each centre's places in what the grid's points read.

        They are those of the polynomial of a ``degree``, below ``count``, in x and y that fits the places best: through
        all of them at the highest degree.
        """
        apart = self._apart(scenario)
        assert apart is not None, "a grid of as many points as there are centres"
        fitting = np.linalg.pinv(chebyshev.chebvander(self._nodes, degree))
        along = chebyshev.chebvander(apart, degree) @ fitting  # (n, 2, count)
        return np.asarray((along[:, 0, :, None] * along[:, 1, None, :]).reshape(len(apart), -1))

    @property
    def _nodes(self) -> FloatArray:
        return np.asarray(-np.cos(np.pi * (np.arange(self.count) + 0.5) / self.count))

    def _apart(self, scenario: Scenario) -> FloatArray | None:
        places = np.array(scenario.grid.places)
        return (places - np.array(self.centres)) / self.reach if places.shape == (len(self.centres), 2) else None


def grid_places(scenario: Scenario, mesh: TissueMesh) -> tuple[GridPlaces, tuple[Port, ...]] | None:
    """Around each point of the ``scenario``'s grid, with ports on the skin of the ``mesh`` that read the normal there.

    None where some place is off the volar skin, where symmetry planes halve the limb, and for grids of more points than
    are worth keeping.
    """
    found = GridPlaces(tuple(scenario.grid.places))
    if len(found.places) > _MOST or any(len(mesh.facets.get(name, ())) for name in _PLANES):
        return None
    skin = skin_of(scenario, mesh)
    try:
        ports = [landed("grid", xy, skin) for xy in turned(scenario, found.places)]
    except GeometryError:
        return None
    return found, tuple(Port(str(k + 1), "point", *places) for k, places in enumerate(ports))
