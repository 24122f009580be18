"""A query laid over the map, from above."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from segloc import SegmentMap, geometry
from segloc.tools.inspect import GREY, ORANGE, plan
from segloc.types import Float32, Float64, Pose

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def query_over_map(
    axes: Axes,
    prior_map: SegmentMap,
    structure: Float32,
    T_map_local: Pose,
    middle: Float64,
    around_m: float,
) -> None:
    """Draw a query's points (N, 3) above ground over the cloud of a map.

    Parameters
    ----------
    middle : (2,) float64
        Of the picture, in the map's frame.
    around_m : float
        Half the width of the picture [m].
    """
    plan(axes, middle - around_m, middle + around_m)
    cloud = prior_map.cloud[:, :2] + prior_map.origin[:2]
    query = geometry.transform(T_map_local, structure)[:, :2]
    for points, colour, size, label in ((cloud, GREY, 0.3, "map"), (query, ORANGE, 0.6, "query")):
        near = np.abs(points - middle).max(axis=1) < around_m
        x, y = points[near].T
        axes.scatter(x, y, s=size, color=colour, label=label, linewidths=0)
