"""``segloc export``"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="MAP_OR_RESULTS", help="A map, or what `localize`, `live` or `align` wrote."
        ),
    ],
    to: Annotated[
        str,
        typer.Option(
            metavar="FORMAT",
            help="Of a map: pcd, ply, laz, autoware. Of `align`: g2o, loops. Of any: tum, geojson.",
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar="FILE_OR_DIR", help="The file; for autoware the folder.")
    ],
    tile: Annotated[
        float, typer.Option(min=1, metavar="METRES", help="Edge of Autoware's tiles.")
    ] = 20.0,
    epsg: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="CODE",
            help="The map's frame, for GeoJSON to name.",
            show_default="not known",
        ),
    ] = None,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="LAT,LON",
            help="Degrees, of the map's origin; x east: GeoJSON by it.",
            show_default="not known",
        ),
    ] = None,
) -> None:
    """Write a map or results in a format of others.

    pcd, ply, laz: the map's cloud. autoware: the same in tiles, with pointcloud_map_metadata.yaml.
    g2o: the scans of aligned sessions, with odometry and loops. loops: these loops as JSON lines.
    tum: poses, by time where the recording has times. geojson: paths.
    """
    from ..export import export as written
    from ..export.formats import Options
    from ..export.tracks import Place
    from .console import busy, note

    place = None if at is None else Place.parse(at)
    with busy("Writing"):
        notes = list(written(source, to, out, Options(tile, epsg, place)))
    for line in notes:
        note(line)
    print(out)
