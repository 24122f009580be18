"""``segloc map from-cloud``"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...system.text import quantity
from . import options
from .console import note, progress


def from_cloud(
    clouds: Annotated[
        list[Path],
        typer.Argument(
            metavar="CLOUD",
            help="PCD, PLY, LAS, LAZ, E57 or XYZ files, or folders of these.",
        ),
    ],
    out: options.MapOut,
    poses: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Pose of each file, TUM or KITTI, if they are submaps in frames of their own.",
            show_default="files share a frame",
        ),
    ] = None,
    trajectory: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Poses that the cloud was measured from, TUM or KITTI.",
            show_default="viewpoints on free ground",
        ),
    ] = None,
    sensor_height: Annotated[
        float,
        typer.Option(min=0.1, max=10, metavar="METRES", help="Height of viewpoints above ground."),
    ] = 1.0,
    level: Annotated[
        bool,
        typer.Option("--level", help="Turn the cloud so that z is up, by its floors and walls."),
    ] = False,
    epsg: options.Epsg = None,
    origin: options.Origin = None,
    method: options.Method = None,
    config: options.ConfigFile = None,
    weights: options.Weights = None,
    threads: options.Threads = 0,
    unchecked: Annotated[
        bool,
        typer.Option("--unchecked", help="Build the map even if unit or axes seem wrong."),
    ] = False,
) -> None:
    """Build a map from a finished point cloud, without scans: a file, tiles, or submaps.

    The cloud stays in its own frame, whose z axis must point up, unless --level turns it; UTM
    coordinates are kept. Files of a folder are sorted by name, 2 before 10.
    """
    from ...map.from_cloud import build_from_cloud, expected_work
    from ...system.files import checked_target
    from ..io import read_trajectory
    from ..io.clouds import WHOLE, cloud_files, count_points, read_cloud
    from .map_info import save_and_show

    checked_target(out, ".segmap")
    where = options.parsed_georeference(epsg, origin)
    settings = options.load_config(config, method, threads, weights)
    settings = options.with_level(settings, level, where)
    path = None if trajectory is None else read_trajectory(trajectory).poses
    placed = None if poses is None else read_trajectory(poses).poses
    files = cloud_files(clouds)
    counts = {file: count_points(file) for file in files}
    points = sum(counts.values())
    at_once = max((n for file, n in counts.items() if file.suffix.lower() in WHOLE), default=0)
    if work := expected_work(points, at_once):
        told = quantity(len(files), "files")
        note(f"{points / 1e6:.1f} million points in {told} by their headers: {work}")
    with progress("Reading and mapping the cloud") as update:
        prior_map = build_from_cloud(
            read_cloud(files, update, placed),
            settings,
            trajectory=path,
            sensor_height=sensor_height,
            check=not unchecked,
            progress=update,
            note=note,
        )
    more = f" and {len(clouds) - 1} more" if len(clouds) > 1 else ""
    prior_map.metadata["sequence"] = f"{clouds[0].resolve().name}{more}"
    save_and_show(prior_map, out, where)
