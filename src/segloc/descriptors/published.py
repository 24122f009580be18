"""DSM (arXiv 2301.13583, section III) and ESM, its predecessor (arXiv 1902.10194)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from .base import AS_PUBLISHED, register
from .pointset import Judge, PointSetDescriptor
from .weightfile import shipped_weights

_JUDGES: Mapping[str, Judge] = {"": "none", "-fq": "pair", "-nq": "nearest"}
"""By suffix, what orders matches: their distances; FC4, which also prunes them, by probability; a
fitted quality of each descriptor."""


def _create(
    network: str, suffix: str, threads: int = 0, weights: Path | None = None
) -> PointSetDescriptor:
    """Create a 16-number learned descriptor."""
    path = weights or shipped_weights(f"{network}.safetensors")
    return PointSetDescriptor(network + suffix, path, judge=_JUDGES[suffix], threads=threads)


for _network in ("dsm", "esm"):
    for _suffix in _JUDGES:
        register(_network + _suffix, preset={"matching": AS_PUBLISHED})(
            partial(_create, _network, _suffix)
        )
