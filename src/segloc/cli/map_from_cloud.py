"""``segloc map from-cloud``"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import options
from .console import note, progress


def from_cloud(
    cloud: Annotated[
        Path,
        typer.Argument(
            metavar="CLOUD",
            help="PCD, PLY, LAS, LAZ, E57 or XYZ file, or a folder of tiles of these.",
        ),
    ],
    out: options.MapOut,
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
    method: options.Method = None,
    config: options.ConfigFile = None,
    weights: options.Weights = None,
    threads: options.Threads = 0,
    unchecked: Annotated[
        bool,
        typer.Option("--unchecked", help="Build the map even if unit or axes seem wrong."),
    ] = False,
) -> None:
    """Build a map from one finished point cloud, without scans or poses.

    The cloud stays in its own frame, whose z axis must point up, unless --level turns it; UTM
    coordinates are kept.
    """
    from ..io import read_trajectory
    from ..io.clouds import read_cloud
    from ..map.from_cloud import build_from_cloud
    from ..system.files import checked_target
    from .map_info import save_and_show

    checked_target(out)
    where = options.parsed_georeference(epsg, None)
    settings = options.load_config(config, method, threads, weights)
    settings = options.with_level(settings, level, where)
    poses = None if trajectory is None else read_trajectory(trajectory).poses
    with progress("Reading and mapping the cloud") as update:
        prior_map = build_from_cloud(
            read_cloud(cloud, update),
            settings,
            trajectory=poses,
            sensor_height=sensor_height,
            check=not unchecked,
            progress=update,
            note=note,
        )
    prior_map.metadata["sequence"] = cloud.name
    save_and_show(prior_map, out, where)
