"""DSM: dilated, down-sampled segments (arXiv 2301.13583, section III)."""

from __future__ import annotations

from .base import register
from .pointset import PointSetDescriptor
from .weightfile import shipped_weights


@register("dsm", preset={"matching": {"growth": 0.0}})
def dsm(threads: int = 0) -> PointSetDescriptor:
    """The 16-number learned descriptor."""
    return PointSetDescriptor("dsm", shipped_weights("dsm.safetensors"), threads=threads)


@register("dsm-fq", preset={"matching": {"growth": 0.0}})
def dsm_fq(threads: int = 0) -> PointSetDescriptor:
    """The same with a quality for each descriptor."""
    return PointSetDescriptor("dsm-fq", shipped_weights("dsm.safetensors"), True, threads)
