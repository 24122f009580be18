"""A failed query from above."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from segloc import geometry
from segloc.batch.run import query_clouds
from segloc.inspect.pictures import DARK, GREY, ORANGE, RED, blank, legend, plan, png
from segloc.types import Float64

from .failures import Case

if TYPE_CHECKING:
    from segloc.localizer import Localizer
    from segloc.types import Recording


def draw_case(
    localizer: Localizer, sequence: Recording, case: Case, position: int, radius_m: float = 60.0
) -> bytes:
    """A failed query from above: its segments under the true pose, on those of the map.

    Parameters
    ----------
    position : int
        Of the query in the sequence.

    Returns
    -------
    bytes
        A PNG image.

    Raises
    ------
    DatasetError
        If a scan cannot be read.
    MissingDependency
        If matplotlib is not installed.
    """
    ((cloud, _),) = query_clouds(sequence, np.array([position]), localizer.config)
    scene = localizer.segmenter.segment(cloud)
    T = np.array(case.T_map_local)
    middle = T[:2, 3]
    figure = blank((8.0, 8.4), 110)
    axes = figure.add_axes((0.01, 0.01, 0.98, 0.93))
    plan(axes, middle - radius_m, middle + radius_m)
    prior_map = localizer.prior_map
    layers: tuple[tuple[Float64, dict[str, Any], str], ...] = (
        (
            prior_map.cloud[:, :2] + prior_map.origin[:2],
            {"s": 0.3, "color": GREY},
            "cloud of the map",
        ),
        (geometry.transform(T, scene.segments.points)[:, :2], {"s": 0.6, "color": ORANGE}, ""),
        (prior_map.centroids[:, :2], {"s": 10, "color": DARK}, "segments of the map"),
        (
            geometry.transform(T, scene.segments.centroids)[:, :2],
            {"s": 46, "facecolors": "none", "edgecolors": RED},
            "segments of the query, under the true pose",
        ),
    )
    for points, style, label in layers:
        near = np.abs(points - middle).max(axis=1) < radius_m if len(points) else slice(0)
        axes.scatter(*points[near].T, label=label or None, **style)
    legend(axes)
    title = f"{case.index}: {case.stage} ({case.segments} segments, {case.repeated} repeated, "
    figure.text(0.02, 0.965, f"{title}{case.matched} matched, {case.inliers} inliers)", fontsize=11)
    return png(figure)
