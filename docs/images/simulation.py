"""Pictures of every simulated world from above, and of one scan of every sensor.

python docs/images/simulation.py docs/images
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot
from segloc_lab.report import parser
from segloc_lab.simulation import SCENES, SENSORS, Conditions, LineLidar, SimulatedSequence
from segloc_lab.simulation.drives import simulate_sessions
from segloc_lab.swathes import swathes

from segloc.tools.inspect.pictures import RED
from segloc.types import Float32, Float64

WORLDS = {"town": 3, "park": 5, "meadow": 2, "forest": 1, "industrial": 4}
CLOUD_M = 75.0
SCAN_M = 35.0


def surroundings(drive: SimulatedSequence) -> tuple[Float32, np.ndarray]:
    """Points of the drive's scans in the world's frame, with the object of each."""
    clouds, ids = [], []
    for i in range(0, len(drive), 3):
        pose = drive.truth[i]
        clouds.append(drive.scan(i).points @ pose[:3, :3].T + pose[:3, 3])
        ids.append(drive.object_ids(i))
    return np.concatenate(clouds).astype(np.float32), np.concatenate(ids)


def draw_world(ax: Any, name: str, seed: int) -> None:
    """Everything above the ground, by height; where the sensor went, in red."""
    world = SCENES[name](seed)
    lidar = SENSORS["hdl64e"]().thinned(3)
    drive = simulate_sessions(world, lidar, [Conditions()], length_m=180.0)[0]
    points, ids = surroundings(drive)
    height = points[:, 2] - world.terrain.height(points[:, 0], points[:, 1])
    middle = drive.truth[:, :2, 3].mean(axis=0)
    near = np.abs(points[:, :2] - middle).max(axis=1) < CLOUD_M
    seen = near & (ids >= 0)
    ground = seen & (height < 0.25)
    ax.scatter(*points[ground][::12, :2].T, s=0.15, c="#d9d4c7", lw=0)
    things = seen & ~ground
    order = np.argsort(height[things])
    ax.scatter(
        *points[things][order][::3, :2].T,
        s=0.5,
        c=np.clip(height[things][order][::3], 0, 9),
        cmap="viridis",
        lw=0,
    )
    ax.plot(*drive.truth[:, :2, 3].T, color=RED, lw=1)
    finish(ax, f"{name}, {len(world.static.kinds)} objects", middle, CLOUD_M)


def draw_scan(ax: Any, name: str) -> None:
    """One scan of a sensor in a town, or one swathe of a push-broom sensor."""
    lidar = SENSORS[name]()
    spacing = 0.1 if isinstance(lidar, LineLidar) else 2.0
    world = SCENES["town"](3)
    drive = simulate_sessions(world, lidar, [Conditions()], length_m=60.0, spacing_m=spacing)[0]
    if isinstance(lidar, LineLidar):
        points = swathes(drive, length_m=30.0).scan(0).points
    else:
        points = drive.scan(len(drive) // 2).points
    near = np.abs(points[:, :2]).max(axis=1) < SCAN_M
    order = np.argsort(points[near][:, 2])
    ax.scatter(
        *points[near][order][:, :2].T,
        s=0.4,
        c=np.clip(points[near][order][:, 2], -2, 5),
        cmap="viridis",
        lw=0,
    )
    what = "swathe of 30 m" if isinstance(lidar, LineLidar) else "scan"
    finish(ax, f"{name}, a {what}, {len(points):,} points", np.zeros(2), SCAN_M)


def finish(ax: Any, title: str, middle: Float64, radius: float) -> None:
    ax.set_aspect("equal")
    ax.set_xlim(middle[0] - radius, middle[0] + radius)
    ax.set_ylim(middle[1] - radius, middle[1] + radius)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_title(title, fontsize=9)
    for spine in ax.spines.values():
        spine.set_visible(False)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("folder", type=Path)
    folder = options.parse_args().folder
    figure, axes = pyplot.subplots(1, len(WORLDS), figsize=(17, 3.8))
    for ax, (name, seed) in zip(axes, WORLDS.items(), strict=True):
        draw_world(ax, name, seed)
    figure.tight_layout()
    figure.savefig(folder / "worlds.png", dpi=90)
    figure, axes = pyplot.subplots(2, 4, figsize=(13, 6.8))
    for ax, name in zip(axes.ravel(), SENSORS, strict=False):
        draw_scan(ax, name)
    for ax in axes.ravel()[len(SENSORS) :]:
        ax.set_axis_off()
    figure.tight_layout()
    figure.savefig(folder / "sensors.png", dpi=80)


if __name__ == "__main__":
    main()
