"""DSM: dilated, down-sampled segments (arXiv 2301.13583, section III)."""

from __future__ import annotations

from pathlib import Path

from .base import register
from .pointset import PointSetDescriptor
from .weightfile import shipped_weights

FILE = "dsm.safetensors"


@register("dsm", preset={"matching": {"growth": 0.0, "escalation": 1}})
def dsm(threads: int = 0, weights: Path | None = None) -> PointSetDescriptor:
    """The 16-number learned descriptor."""
    return PointSetDescriptor("dsm", weights or shipped_weights(FILE), threads=threads)


@register("dsm-fq", preset={"matching": {"growth": 0.0, "escalation": 1}})
def dsm_fq(threads: int = 0, weights: Path | None = None) -> PointSetDescriptor:
    """The same with a quality for each descriptor."""
    return PointSetDescriptor("dsm-fq", weights or shipped_weights(FILE), True, threads)
