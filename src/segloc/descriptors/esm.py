"""ESM: DSM's predecessor, with more representative points (arXiv 1902.10194)."""

from __future__ import annotations

from .base import register
from .pointset import PointSetDescriptor
from .weightfile import shipped_weights


@register("esm", preset={"matching": {"growth": 0.0}})
def esm(threads: int = 0) -> PointSetDescriptor:
    """The 16-number learned descriptor."""
    return PointSetDescriptor("esm", shipped_weights("esm.safetensors"), threads=threads)


@register("esm-fq", preset={"matching": {"growth": 0.0}})
def esm_fq(threads: int = 0) -> PointSetDescriptor:
    """The same with a quality for each descriptor."""
    return PointSetDescriptor("esm-fq", shipped_weights("esm.safetensors"), True, threads)
