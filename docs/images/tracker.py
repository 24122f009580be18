"""Draw the moving picture of docs/how-to/live.md: a lost robot that finds itself.

python docs/images/tracker.py     # writes tracker.webp beside itself; needs segloc-lab
"""

from __future__ import annotations

import argparse
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from segloc_lab.simulation import Conditions, hdl64e, simulate_sessions, town, vlp16

from segloc import Config, Localizer, build_map, geometry
from segloc.map.segment_map import SegmentMap
from segloc.tools.datasets.recorded import parse_select
from segloc.tools.inspect.pictures import (
    BLUE,
    DARK,
    GREEN,
    ORANGE,
    PATH,
    RED,
    blank,
    density,
    dots,
    plan,
    png,
    scale,
)
from segloc.tracker import Track, Tracker, TrackerConfig
from segloc.tracking.belief import Status
from segloc.types import Float32, Float64, Pose

SEED, SIZE_M, LENGTH_M, UNMAPPED = 7, 150.0, 110.0, 22
"""The first scans of the drive lie before the beginning of the map."""
EVERY, MARGIN_M, SMALLER_M = 2, 22.0, 34.0
SIZE_IN, DPI, MILLISECONDS, LAST_MS, QUALITY = (8.4, 4.8), 90, 350, 2500, 60
COLOURS = {
    Status.LOST: RED,
    Status.CANDIDATE: ORANGE,
    Status.LOCALIZED: GREEN,
    Status.DEGRADED: ORANGE,
}


@dataclass(frozen=True)
class Step:
    """A scan, where the odometry and the truth had it, and the answer of the tracker."""

    points: Float32
    T_odom_sensor: Pose
    truth: Pose
    track: Track

    @property
    def T_map_sensor(self) -> Pose | None:
        T = self.track.T_map_odom
        return None if T is None else T @ self.T_odom_sensor


def followed() -> tuple[SegmentMap, list[Step]]:
    """A map of most of a drive, and the tracker on all of a later one, with another sensor."""
    world, later = town(SEED, size_m=SIZE_M), Conditions(foliage=0.7, replaced=0.1)
    first = simulate_sessions(world, hdl64e(600), [Conditions()], length_m=LENGTH_M)[0]
    sessions = [Conditions(), later]
    drive = simulate_sessions(world, vlp16(900), sessions, length_m=LENGTH_M)[1].with_odometry()
    config = Config.preset("profile").model_copy(update={"threads": 1})
    prior_map = build_map(first.select(parse_select(f"{UNMAPPED}:{len(first)}")), config)
    tracker = Tracker(Localizer(prior_map, config), TrackerConfig(accumulate=True, every_m=6.0))
    steps = []
    for i in range(len(drive)):
        scan = drive.scan(i)
        track = tracker.update(scan, drive.poses[i])
        steps.append(Step(scan.points, drive.poses[i], drive.truth[i], track))
    return prior_map, steps


def frames(prior_map: SegmentMap, steps: list[Step]) -> list[Image.Image]:
    """A picture for every few scans: what the robot sees, and where it is in the map."""
    cloud = prior_map.cloud[:, :2] + prior_map.origin[:2]
    truths = np.array([step.truth[:2, 3] for step in steps])
    low = np.minimum(np.percentile(cloud, 2, axis=0), truths.min(axis=0)) - 0.3 * MARGIN_M
    high = np.maximum(np.percentile(cloud, 98, axis=0), truths.max(axis=0)) + 0.3 * MARGIN_M
    return [_frame(cloud, steps[: k + 1], low, high) for k in range(EVERY - 1, len(steps), EVERY)]


def _frame(cloud: Any, steps: list[Step], low: Float64, high: Float64) -> Image.Image:
    now = steps[-1]
    figure = blank(SIZE_IN, DPI)
    seen = figure.add_axes((0.005, 0.02, 0.33, 0.86))
    plan(seen, (-SMALLER_M, -SMALLER_M), (SMALLER_M, SMALLER_M))
    dots(seen, now.points, s=0.5, color=PATH)
    seen.plot(0, 0, marker=(3, 0, -90), ms=10, color=DARK)
    scale(seen)
    where = figure.add_axes((0.345, 0.02, 0.65, 0.86))
    plan(where, low, high)
    density(where, cloud, low, high)
    truth = np.array([step.truth[:2, 3] for step in steps])
    where.plot(*truth.T, color=BLUE, lw=1.2, ls=(0, (1, 2)), zorder=2)
    where.plot(*truth[-1], "o", ms=9, mfc="none", color=BLUE, zorder=3)
    _answers(where, steps)
    _words(figure, steps)
    with Image.open(io.BytesIO(png(figure))) as image:
        return image.convert("RGB")


def _answers(axes: Any, steps: list[Step]) -> None:
    found = [T[:2, 3] for step in steps if (T := step.T_map_sensor) is not None]
    if found:
        axes.plot(*np.array(found).T, color=GREEN, lw=2.2, zorder=4)
    now = steps[-1]
    if (T := now.T_map_sensor) is not None:
        near = now.points[np.linalg.norm(now.points[:, :2], axis=1) < SMALLER_M]
        high = near[near[:, 2] > -1.2]  # what stands
        dots(axes, geometry.transform(T, high), s=0.7, color=COLOURS[now.track.status], zorder=3)
        axes.plot(*T[:2, 3], "o", ms=6, color=COLOURS[now.track.status], mec="white", zorder=5)


def _words(figure: Any, steps: list[Step]) -> None:
    now = steps[-1].track
    moves = np.diff([step.truth[:3, 3] for step in steps], axis=0)
    path = float(np.linalg.norm(moves, axis=1).sum()) if len(moves) else 0.0
    style = {"fontsize": 10, "va": "center", "color": DARK}
    figure.text(0.01, 0.95, f"what it sees, after {path:.0f} m", **style)
    views = f", {now.views} views agree" if now.localized else ""
    bold = {**style, "weight": "bold", "color": COLOURS[now.status]}
    figure.text(0.35, 0.95, f"{now.status}{views}", **bold)
    figure.text(0.99, 0.95, "the map; dotted: the truth", ha="right", **style)


def save(pictures: list[Image.Image], path: Path) -> None:
    """One WebP that goes round, and rests on the last picture."""
    times = [MILLISECONDS] * (len(pictures) - 1) + [LAST_MS]
    first, *rest = pictures
    first.save(
        path, save_all=True, append_images=rest, duration=times, loop=0, quality=QUALITY, method=4
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("tracker.webp"))
    options = parser.parse_args()
    save(frames(*followed()), options.out)


if __name__ == "__main__":
    main()
