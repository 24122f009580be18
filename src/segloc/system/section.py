"""What every section of the configuration refuses: unknown keys, NaN and infinity."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A section of the configuration, or of a file beside the weights."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
