"""What every part of a scenario shares: frozen, unknown keys refused, every number finite."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Length = Annotated[float, Field(gt=0, le=2.0, description="a length in metres")]
Fraction = Annotated[float, Field(gt=0, lt=1)]


class Part(BaseModel):
    """Base of all scenario parts; ``allow_inf_nan`` is off so that NaN never enters a solve."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
