"""Draw the picture of the README: a scan that drops into its place in the map.

python docs/images/hero.py        # writes hero.png beside itself; needs the extra report
"""

from __future__ import annotations

import argparse
import io
import math
from colorsys import hsv_to_rgb
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from PIL import Image

from segloc import Config, Localizer, build_map, geometry, sample
from segloc.frontend.local_cloud import Accumulator
from segloc.map.segment_map import SegmentMap
from segloc.tools.inspect import Trace, trace
from segloc.tools.inspect.pictures import DARK, GREEN, GREY, PATH, blank, hue, png, rgb

QUERY = 4
LIFTED_M, ELEVATION_DEG, AZIMUTH_DEG = 38.0, 32.0, 68.0
RADIUS_M, CLOUD_RADIUS_M = 58.0, 32.0
SIZE_IN, DPI, COLOURS = (11.0, 7.0), 110, 96


def seen_from_aside(points: Any) -> Any:
    """(N, 3) points to (N, 2) on the page and (N,) depth, larger farther: no perspective."""
    turn = math.radians(AZIMUTH_DEG)
    across = points[:, 0] * math.sin(turn) - points[:, 1] * math.cos(turn)
    away = points[:, 0] * math.cos(turn) + points[:, 1] * math.sin(turn)
    tilt = math.radians(ELEVATION_DEG)
    up = away * math.sin(tilt) + points[:, 2] * math.cos(tilt)
    return np.column_stack([across, up]), away


def answered(query: int) -> tuple[SegmentMap, Trace]:
    """A map of the sample's Monday, and how a scan of its Tuesday is found in it."""
    monday, tuesday = sample.load("monday"), sample.load("tuesday")
    config = Config.preset("profile").model_copy(update={"threads": 1})
    localizer = Localizer(build_map(monday, config), config)
    cloud = Accumulator(config.local_cloud).gather(tuesday.scan(query))
    found = trace(localizer, cloud)
    if not found.result.localized:
        raise SystemExit(f"scan {query} is not localized: {found.result.message}")
    return localizer.prior_map, found


def picture(prior_map: SegmentMap, found: Trace) -> bytes:
    """The map below, the scan's segments above it and in it, and the matches that agree."""
    assert found.T_map_local is not None
    T, middle = found.T_map_local, found.T_map_local[:3, 3]
    lift = np.array([0.0, 0.0, LIFTED_M])
    figure = blank(SIZE_IN, DPI)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_aspect("equal")

    below = _near(prior_map.cloud + prior_map.origin - middle, RADIUS_M)
    _cloud(axes, below, _by_height(below), 1.1)
    segments = found.segments
    placed = geometry.transform(T, segments.points) - middle
    colours = _colours(np.repeat(np.arange(len(segments)), segments.sizes), len(segments))
    inside = np.linalg.norm(placed[:, :2], axis=1) < CLOUD_RADIUS_M
    matched = np.zeros(len(segments), bool)
    matched[found.pairs[found.inliers, 0]] = True
    fits = inside & np.repeat(matched, segments.sizes)
    _cloud(axes, placed[fits], colours[fits], 1.4)
    _matches(axes, prior_map, found, middle)
    rest = geometry.transform(T, found.structure) - middle
    _cloud(axes, _near(rest, CLOUD_RADIUS_M) + lift, DARK, 0.25, 0.5)
    _cloud(axes, placed[inside] + lift, colours[inside], 1.0)
    _words(axes, found)
    low = -0.56 * RADIUS_M
    axes.set_xlim(-1.25 * RADIUS_M, 1.25 * RADIUS_M)
    axes.set_ylim(low, low + 2.5 * RADIUS_M * SIZE_IN[1] / SIZE_IN[0])
    return png(figure)


def _by_height(points: Any) -> Any:
    """From pale on the ground to darker on top."""
    low, high = np.percentile(points[:, 2], [5, 95])
    share = ((points[:, 2] - low) / max(high - low, 1e-6)).clip(0.0, 1.0)[:, None]
    return (np.array(rgb(GREY)) + share * (np.array(rgb(PATH)) - np.array(rgb(GREY)))) / 255.0


def _near(points: Any, radius_m: float) -> Any:
    return points[np.linalg.norm(points[:, :2], axis=1) < radius_m]


def _colours(owners: Any, count: int) -> Any:
    wheel = np.array([hsv_to_rgb(hue(k), 0.8, 0.85) for k in range(count)]).reshape(-1, 3)
    return wheel[owners]


def _cloud(axes: Any, points: Any, colours: Any, size: float, alpha: float = 1.0) -> None:
    """Far points first."""
    page, depth = seen_from_aside(points)
    order = np.argsort(-depth, kind="stable")
    colours = colours[order] if not isinstance(colours, str) else colours
    axes.scatter(*page[order].T, s=size, c=colours, linewidths=0, alpha=alpha)


def _matches(axes: Any, prior_map: SegmentMap, found: Trace, middle: Any) -> None:
    T = found.T_map_local
    pairs = found.pairs[found.inliers]
    above = geometry.transform(T, found.segments.centroids)[pairs[:, 0]] - middle
    near = np.linalg.norm(above[:, :2], axis=1) < CLOUD_RADIUS_M
    above = above[near] + [0.0, 0.0, LIFTED_M]
    below = prior_map.centroids[pairs[near, 1]] - middle
    lines = np.stack([seen_from_aside(above)[0], seen_from_aside(below)[0]], axis=1)
    axes.add_collection(LineCollection(list(lines), colors=GREEN, linewidths=1.1, alpha=0.9))


def _words(axes: Any, found: Trace) -> None:
    result = found.result
    x, y, _ = found.T_map_local[:3, 3]
    yaw = math.degrees(geometry.heading(result.T_map_sensor))
    left = -1.21 * RADIUS_M
    style = {"color": DARK, "fontsize": 12.5, "va": "center"}
    axes.text(left, 1.1 * LIFTED_M, "one scan of today,\ncut into segments", **style)
    axes.text(
        left, 0.52 * LIFTED_M, f"{found.inliers.sum()} matches agree", **{**style, "color": GREEN}
    )
    axes.text(left, -0.42 * LIFTED_M, "the map of\nanother day", **style)
    label = f"x {x:.1f} m, y {y:.1f} m, yaw {yaw:.0f}°\nconfidence {result.confidence:.2f}"
    axes.text(1.21 * RADIUS_M, -0.46 * RADIUS_M, label, ha="right", **{**style, "weight": "bold"})


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("hero.png"))
    options = parser.parse_args()
    drawn = picture(*answered(QUERY))
    with Image.open(io.BytesIO(drawn)) as image:  # few colours keep it small
        few = image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        few.save(options.out, optimize=True)


if __name__ == "__main__":
    main()
