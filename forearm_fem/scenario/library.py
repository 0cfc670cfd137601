"""The patch of skin that an arm's library answers for."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from .base import Part, Within


class LibraryPatch(Part):
    """A rectangle of volar skin about the origin, in lengths along the skin; discs must lie on it whole."""

    length: Annotated[float, Within(0.01, 0.4, "m")] = Field(0.08, description="of the patch along the limb [m]")
    width: Annotated[float, Within(0.01, 0.4, "m")] = Field(
        0.064, description="of the patch across the limb [m]; discs stand on skin at most 60 degrees from facing up"
    )
    step: Annotated[float, Within(0.001, 0.02, "m")] = Field(
        0.004, description="between the loads that are solved for [m]; what lies between them is interpolated"
    )
