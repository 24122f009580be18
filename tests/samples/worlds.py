"""Simulated worlds, made again although they are kept."""

from __future__ import annotations

import sys
from collections.abc import Callable

from segloc_lab.simulation import World


def made_anew(make: Callable[..., World], seed: int, size_m: float) -> World:
    """The world of a seed, not the one that was made of it before."""
    for each in vars(sys.modules[make.__module__]).values():
        if hasattr(each, "cache_clear"):
            each.cache_clear()
    return make(seed, size_m=size_m)
