"""ESM: DSM's predecessor, with more representative points (arXiv 1902.10194)."""

from __future__ import annotations

from pathlib import Path

from .base import register
from .pointset import PointSetDescriptor
from .weightfile import shipped_weights

FILE = "esm.safetensors"


@register("esm", preset={"matching": {"growth": 0.0, "escalation": 1}})
def esm(threads: int = 0, weights: Path | None = None) -> PointSetDescriptor:
    """Create the 16-number learned descriptor."""
    return PointSetDescriptor("esm", weights or shipped_weights(FILE), threads=threads)


@register("esm-fq", preset={"matching": {"growth": 0.0, "escalation": 1}})
def esm_fq(threads: int = 0, weights: Path | None = None) -> PointSetDescriptor:
    """Create the same descriptor; FC4 orders and prunes matches by their probability."""
    path = weights or shipped_weights(FILE)
    return PointSetDescriptor("esm-fq", path, judge="pair", threads=threads)


@register("esm-nq", preset={"matching": {"growth": 0.0, "escalation": 1}})
def esm_nq(threads: int = 0, weights: Path | None = None) -> PointSetDescriptor:
    """Create the same descriptor; matches are ordered by a fitted quality of each descriptor."""
    path = weights or shipped_weights(FILE)
    return PointSetDescriptor("esm-nq", path, judge="nearest", threads=threads)
