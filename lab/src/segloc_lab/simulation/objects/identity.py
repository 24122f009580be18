"""Triangles of many objects, and what each object is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from segloc.types import Float32

from .mesh import LEAF, Mesh, UInt8, join

Int32: TypeAlias = NDArray[np.int32]

GROUND_ID = 0
SESSION_IDS = 1_000_000
"""Objects that stay have ids below this; those of session k start at ``(k + 1) * SESSION_IDS``."""


@dataclass(frozen=True)
class Objects:
    """Triangles of many objects.

    Attributes
    ----------
    triangles : (T, 3, 3) float32
        World frame, metres.
    reflectance : (T,) float32
    material : (T,) uint8
    object_ids : (T,) int32
    lots : (T,) float32
        A number in [0, 1) that each triangle keeps: which leaf falls when, which pane is dirty.
    kinds : dict
        What each object id is: "house", "tree", "car", ...
    """

    triangles: Float32
    reflectance: Float32
    material: UInt8
    object_ids: Int32
    lots: Float32
    kinds: dict[int, str]

    @staticmethod
    def of(items: list[tuple[str, Mesh]], first_id: int) -> Objects:
        """Number (kind, mesh) items upwards from ``first_id``."""
        sizes = [len(mesh) for _, mesh in items]
        ids = first_id + np.repeat(np.arange(len(items)), sizes)
        surface = join(mesh for _, mesh in items)
        return Objects(
            surface.triangles.astype(np.float32),
            surface.reflectance,
            surface.material,
            ids.astype(np.int32),
            _lots(first_id, len(ids)),
            {first_id + k: kind for k, (kind, _) in enumerate(items)},
        )

    def only(self, mask: NDArray[np.bool_]) -> Objects:
        """The triangles of a (T,) mask, and the kinds of the objects that are left."""
        ids = self.object_ids[mask]
        return Objects(
            self.triangles[mask],
            self.reflectance[mask],
            self.material[mask],
            ids,
            self.lots[mask],
            {int(k): self.kinds[int(k)] for k in np.unique(ids)},
        )

    def with_foliage(self, share: float) -> Objects:
        """The objects with that share of their leaves."""
        if share == 1:
            return self
        return self.only((self.material != LEAF) | (self.lots < share))


def _lots(first: int, count: int) -> Float32:
    """A number in [0, 1) for each of ``count`` numbers from ``first``: without a pattern."""
    mixed = np.arange(count, dtype=np.uint64) + np.uint64(first)
    mixed *= np.uint64(0x9E3779B97F4A7C15)
    mixed ^= mixed >> np.uint64(29)
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    mixed ^= mixed >> np.uint64(32)
    return np.asarray((mixed >> np.uint64(40)).astype(np.float32) * np.float32(2.0**-24))
