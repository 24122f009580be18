"""Configuration of verification."""

from __future__ import annotations

from pydantic import Field

from ..system.section import Section


class VerificationConfig(Section):
    """Verification of poses.

    All other parameters are constants, because the model was fitted with them.
    """

    min_confidence: float = Field(
        0.99, ge=0.5, le=1, description="least probability of an accepted place"
    )
    refine: bool = Field(True, description="refine the pose by ICP")
