"""How finely the limb is cut into tetrahedra; sizes left out follow from ``accuracy`` and ``f_max``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from .base import Part, Within

Element = Literal["P1", "P2", "P2/P3", "P3"]
Size = Annotated[float, Within(1e-4, 2.0, "m")]


class MeshOptions(Part):
    """Element sizes [m]; ``None`` means: chosen from the scenario's ``accuracy``."""

    size_contact: Size | None = Field(None, description="edge length under and beside contacts [m]")
    size_grid: Size | None = Field(None, description="edge length between contacts and grid points [m]")
    size_far: Size | None = Field(None, description="edge length far from all ports [m]")
    grading: Annotated[float, Within(0.01, 1.0)] = Field(0.3, description="growth of size per metre of distance")
    sublayers: dict[str, Annotated[int, Within(1, 20)]] = Field(
        default_factory=dict, description="element layers through each tissue layer, e.g. {skin = 1, fat = 2}"
    )
    element: Element | Literal["auto"] = Field(
        "auto",
        description="displacement order, pressure is one lower; P2/P3 is third order around the ports and second "
        "elsewhere; auto: P2/P3 on forearm and cylinder, and on slabs without size_grid where accuracy is 0.05 or "
        "better, cones are rigid, or a point is less than 8 mm from the rim of a disc of pressure",
    )
    min_quality: Annotated[float, Within(1e-6, 0.999)] = Field(
        0.02, description="smallest mean-ratio quality accepted (1 = regular tetrahedron)"
    )
    max_elements: Annotated[float, Within(1, 1e10)] = Field(2e6, description="refuse larger meshes than this")
