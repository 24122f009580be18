"""DSM: dilated, down-sampled segments (arXiv 2301.13583, section III)."""

from __future__ import annotations

from pathlib import Path

from .base import register
from .pointset import PointSetDescriptor
from .weightfile import shipped_weights

FILE = "dsm.safetensors"


@register("dsm", preset={"matching": {"growth": 0.0, "escalation": 1}})
def dsm(threads: int = 0, weights: Path | None = None) -> PointSetDescriptor:
    """Create the 16-number learned descriptor."""
    return PointSetDescriptor("dsm", weights or shipped_weights(FILE), threads=threads)


@register("dsm-fq", preset={"matching": {"growth": 0.0, "escalation": 1}})
def dsm_fq(threads: int = 0, weights: Path | None = None) -> PointSetDescriptor:
    """Create the same descriptor; FC4 orders and prunes matches by their probability."""
    path = weights or shipped_weights(FILE)
    return PointSetDescriptor("dsm-fq", path, judge="pair", threads=threads)


@register("dsm-nq", preset={"matching": {"growth": 0.0, "escalation": 1}})
def dsm_nq(threads: int = 0, weights: Path | None = None) -> PointSetDescriptor:
    """Create the same descriptor; matches are ordered by a fitted quality of each descriptor."""
    path = weights or shipped_weights(FILE)
    return PointSetDescriptor("dsm-nq", path, judge="nearest", threads=threads)
