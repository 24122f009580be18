"""``segloc export``"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...errors import ConfigError
from .console import busy, note

EpsgOfLines = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="CODE",
        help="EPSG code of the map's frame: GeoJSON in its metres, not in degrees.",
        show_default="unknown",
    ),
]
OriginOfLines = Annotated[
    str | None,
    typer.Option(
        metavar="LAT,LON",
        help="Origin of the map [degrees], for GeoJSON; x points east.",
        show_default="unknown",
    ),
]


def export(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="MAP_OR_RESULTS",
            help="A map, or a results folder of `localize`, `live` or `align`.",
        ),
    ],
    to: Annotated[
        str,
        typer.Option(
            metavar="FORMAT",
            help="Maps: pcd, ply, laz, autoware, nav2; `align`: g2o, loops; any: tum, geojson.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(metavar="FILE_OR_DIR", help="Output file; for autoware and nav2 a folder."),
    ],
    tile: Annotated[
        float, typer.Option(min=1, max=1e5, metavar="METRES", help="Edge of the Autoware tiles.")
    ] = 20.0,
    resolution: Annotated[
        float, typer.Option(metavar="METRES", help="Edge of a cell of the nav2 grid.")
    ] = 0.05,
    heights: Annotated[
        str,
        typer.Option(metavar="LOW,HIGH", help="Heights of obstacles above ground [m], for nav2."),
    ] = "0.4,1.8",
    robot_width: Annotated[
        float,
        typer.Option(
            metavar="METRES", help="Width of the robot: nav2 is free where it drove; 0: as seen."
        ),
    ] = 0.6,
    epsg: EpsgOfLines = None,
    at: OriginOfLines = None,
    cloud_frame: Annotated[
        bool,
        typer.Option(
            "--cloud-frame", help="Poses in the frame of the cloud that `--level` turned."
        ),
    ] = False,
) -> None:
    """Export a map or results to another format.

    pcd, ply, laz: the map's cloud. autoware: the cloud in tiles, with pointcloud_map_metadata.yaml.
    nav2: occupancy grid, map.pgm and map.yaml, one pair per storey. g2o: the scans of aligned
    sessions, with odometry and loops. loops: these loops as JSON lines. tum: poses, by stamp if the
    recording has stamps. geojson: drives, and poses found with yaw, confidence and covariance.
    """
    from ..export import export as written
    from ..export.formats import Options
    from ..export.nav2 import GridOptions
    from ..export.tracks import Place

    grid = GridOptions(resolution, *_slice(heights), robot_width)
    place = None if at is None else Place.parse(at)
    with busy("Writing"):
        notes = list(written(source, to, out, Options(tile, epsg, place, grid, cloud_frame)))
    for line in notes:
        note(line)
    print(out)


def _slice(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigError(f"--heights expects LOW,HIGH in metres, not {text[:40]!r}") from error
    return low, high
