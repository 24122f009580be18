"""NSM: Gestalt descriptors at oriented key poses, and a forest over pairs (arXiv 1809.02846)."""

from __future__ import annotations

import numpy as np

from .. import _native
from ..types import Descriptors, Segments
from .base import AS_PUBLISHED, register
from .random_forest import ForestDescriptor, Layout

BINS = 32
RADIUS_M = 5.0
SHAPE_WEIGHT = 2.0
"""Planarity and cylindricality lie in [0, 1]; the other numbers are metres."""


@register("nsm", preset={"matching": {"neighbours": 200, **AS_PUBLISHED}})
class GestaltDescriptor(ForestDescriptor):
    """Heights of a segment's points in 4 rings of 8 sectors around its key pose (66 numbers).

    Mean and standard deviation of the height in each bin, planarity and cylindricality. Bosse and
    Zlot store the variance; its root is in metres like the mean, and suits Euclidean distance. The
    key pose is at the segment's mean, with a vertical z axis and its x axis along the thinnest
    horizontal direction. Only the segment's own points count: its surroundings change more between
    visits.
    """

    name = "nsm"
    dim = 2 * BINS + 2
    fingerprint = "nsm-1"
    layout = Layout(plain=2 * BINS + 2)

    def encode(self, segments: Segments) -> Descriptors:
        """Return (P, 66) vectors; see the class."""
        vectors = _native.gestalt(segments.points, segments.offsets, RADIUS_M, self._threads)
        vectors[:, BINS : 2 * BINS] = np.sqrt(vectors[:, BINS : 2 * BINS])
        vectors[:, 2 * BINS :] *= SHAPE_WEIGHT
        return Descriptors(vectors)
