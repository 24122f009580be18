"""ESM: DSM's predecessor, with more representative points (arXiv 1902.10194)."""

from __future__ import annotations

from pathlib import Path

from .base import register
from .pointset import PointSetDescriptor
from .weightfile import shipped_weights

FILE = "esm.safetensors"


@register("esm", preset={"matching": {"growth": 0.0, "escalation": 1}})
def esm(threads: int = 0, weights: Path | None = None) -> PointSetDescriptor:
    """The 16-number learned descriptor."""
    return PointSetDescriptor("esm", weights or shipped_weights(FILE), threads=threads)


@register("esm-fq", preset={"matching": {"growth": 0.0, "escalation": 1}})
def esm_fq(threads: int = 0, weights: Path | None = None) -> PointSetDescriptor:
    """The same with a quality for each descriptor."""
    return PointSetDescriptor("esm-fq", weights or shipped_weights(FILE), True, threads)
