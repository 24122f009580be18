"""``segloc map tile``"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .console import note, progress, table


def tile(
    prior_map: Annotated[Path, typer.Argument(metavar="MAP.segmap", help="The map.")],
    out: Annotated[
        str,
        typer.Option(
            metavar="DIR_OR_URL", help="Folder or URL of the tiles; unchanged tiles are kept."
        ),
    ],
    size: Annotated[float, typer.Option(metavar="METRES", help="Edge of a tile.")] = 500.0,
    margin: Annotated[
        float, typer.Option(metavar="METRES", help="Overlap of a tile with its neighbours.")
    ] = 60.0,
) -> None:
    """Cut a map into overlapping tiles with an index, for maps too large for memory.

    `segloc localize --map DIR_OR_URL` opens the required tiles.
    """
    from ...config import map_config
    from ...map.segment_map import SegmentMap
    from ...tiles import cut_tiles

    whole = SegmentMap.load(prior_map)
    if margin < (reach_m := map_config(whole).local_cloud.radius_m):
        note(
            f"a margin of {margin:g} m is less than scans reach, {reach_m:g} m: what lies farther "
            "from the squares of the trajectory is left out, and fewer scans are found at borders"
        )
    with progress("Cutting") as update:
        index = cut_tiles(whole, out, size_m=size, margin_m=margin, progress=update)
    megabytes = sum(each.bytes for each in index.tiles) / 1e6
    rows = [
        ("tiles", f"{len(index.tiles)}, {index.size_m:g} m wide, {index.margin_m:g} m around"),
        ("size of files", f"{megabytes:.1f} MB"),
        ("segments", f"{sum(each.segments for each in index.tiles)}"),
        ("thin map of all", f"{index.coarse.segments} segments, {index.coarse.bytes / 1e6:.1f} MB"),
    ]
    table(out, ("", ""), rows)
