"""Points of upright things -> axis, foot and diameter of each, all at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...types import Float64
from .stem_clusters import Upright

_STEPS = 3
"""Of reweighting: twigs and undergrowth that hang on a stem lose their say."""
_STEEPEST = 0.2
"""Run over rise of an axis: trees lean less."""
_UPRIGHT_M2 = 0.2
"""As much as a point so far (squared metres) along the axis that says it is upright."""
_NOISE_M = 0.04
"""Of ranges and bark: residuals below it say nothing."""
_MOST_RADIUS_M = 0.6
_MIDDLE = (0.05, 0.95)
"""Of the points across the line of sight: what lies beyond is twigs, and beams that saw an edge."""
_LEAST_DIAMETER_M = 0.05


@dataclass(frozen=True)
class Fits:
    """Axes and circles of K things.

    Attributes
    ----------
    feet : (K, 3) float64
        Where each axis meets the ground.
    leans : (K, 2) float64
        Run over rise of each axis along x and y.
    diameters : (K,) float64
        Metres.
    deviations : (K,) float64
        Of the points from the circle, root mean square after reweighting, metres.
    """

    feet: Float64
    leans: Float64
    diameters: Float64
    deviations: Float64


class _Sums:
    """Sums over the points of each of K things."""

    def __init__(self, things: Upright) -> None:
        self.which = np.repeat(np.arange(len(things)), things.counts)
        self._count = len(things)

    def __call__(self, values: Float64) -> Float64:
        sums: Float64 = np.bincount(self.which, values, self._count).astype(np.float64)
        return sums


def fitted(things: Upright, seen_from_origin: bool) -> Fits:
    """The axis and the circle that fit each thing best.

    Parameters
    ----------
    things : Upright
    seen_from_origin : bool
        Whether all points were seen from (0, 0), so that only one side of each thing is there:
        then its width across the line of sight is its diameter. Else a circle is fitted.
    """
    sums = _Sums(things)
    x, y, z = things.points.T
    middle = sums(z) / np.maximum(things.counts, 1)
    up = z - middle[sums.which]
    weight = np.ones(len(z))
    for _ in range(_STEPS):
        leans, level = _axes(sums, weight, x, y, up)
        circle = _one_sided if seen_from_origin else _all_around
        centre, radius = circle(sums, weight, level, things)
        off = np.hypot(*(level - centre[sums.which]).T) - radius[sums.which]
        total = np.maximum(sums(weight), 1e-9)
        deviation = np.sqrt(sums(weight * off**2) / total)
        scale = np.maximum(deviation, _NOISE_M)[sums.which]
        weight = 1.0 / (1.0 + (off / (1.5 * scale)) ** 2)
    ground = middle - sums(things.heights) / np.maximum(things.counts, 1)
    feet = np.column_stack([centre + leans * (ground - middle)[:, None], ground])
    return Fits(feet, leans, np.maximum(2 * radius, _LEAST_DIAMETER_M), deviation)


def _axes(
    sums: _Sums, weight: Float64, x: Float64, y: Float64, up: Float64
) -> tuple[Float64, Float64]:
    """Leans, and the points moved along them to the middle height of each thing, (M, 2)."""
    total = np.maximum(sums(weight), 1e-9)
    mean = sums(weight * up) / total
    rise = weight * (up - mean[sums.which])
    spread = sums(rise * up) + total * _UPRIGHT_M2
    leans = np.stack([sums(rise * x) / spread, sums(rise * y) / spread], axis=1)
    leans = np.clip(leans, -_STEEPEST, _STEEPEST)
    return leans, np.stack([x, y], axis=1) - up[:, None] * leans[sums.which]


def _all_around(
    sums: _Sums, weight: Float64, level: Float64, things: Upright
) -> tuple[Float64, Float64]:
    """Centres and radii of circles with the least squares of (r^2 - radius^2): I. Kasa, "A circle
    fitting procedure and its error analysis", IEEE Trans. Instrum. Meas. 25, 1976.

    Points all on one side, or in a heap, say little of the centre: where the circle is far larger
    than the points reach, their mean is taken.
    """
    total = np.maximum(sums(weight), 1e-9)
    mean = np.stack([sums(weight * c) / total for c in level.T], axis=1)
    u, v = (level - mean[sums.which]).T
    square = u * u + v * v
    products = [sums(weight * a * b) / total for a, b in ((u, u), (u, v), (v, v))]
    uu, uv, vv = products[0] + 1e-3, products[1], products[2] + 1e-3
    right = [sums(weight * a * square) / (2 * total) for a in (u, v)]
    det = uu * vv - uv * uv
    shift = np.stack([vv * right[0] - uv * right[1], uu * right[1] - uv * right[0]], axis=1)
    shift /= det[:, None]
    spread = np.sqrt(sums(weight * square) / total)
    radius = np.sqrt((shift**2).sum(axis=1) + spread**2)
    vague = (radius > _MOST_RADIUS_M) | (radius > 2 * spread + 0.05)
    shift[vague], radius[vague] = 0.0, spread[vague]
    return mean + shift, radius


def _one_sided(
    sums: _Sums, weight: Float64, level: Float64, things: Upright
) -> tuple[Float64, Float64]:
    """Centres and radii of things seen from (0, 0): their width is seen, and their near side."""
    total = np.maximum(sums(weight), 1e-9)
    mean = np.stack([sums(weight * c) / total for c in level.T], axis=1)
    ahead = mean / np.maximum(np.hypot(*mean.T), 1e-9)[:, None]
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    off = level - mean[sums.which]
    across = (off * aside[sums.which]).sum(axis=1)
    order = np.lexsort((across, sums.which))
    low, high = (
        across[order][things.starts + (share * (things.counts - 1) + 0.5).astype(np.int64)]
        for share in _MIDDLE
    )
    radius = np.minimum(np.maximum((high - low) / 2, _LEAST_DIAMETER_M / 2), _MOST_RADIUS_M)
    centre = (low + high) / 2
    sideways = np.minimum(np.abs(across - centre[sums.which]) / radius[sums.which], 1.0)
    depth = (off * ahead[sums.which]).sum(axis=1) + radius[sums.which] * np.sqrt(1 - sideways**2)
    behind = sums(weight * depth) / total
    return mean + centre[:, None] * aside + behind[:, None] * ahead, radius
