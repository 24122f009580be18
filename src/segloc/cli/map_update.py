"""``segloc map update``"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import (
    ConfigFile,
    Deskew,
    Elsewhere,
    MapOut,
    Recording,
    Select,
    Threads,
    Topic,
    Weights,
    map_settings,
)


def update(
    prior_map: Annotated[Path, typer.Argument(metavar="MAP.segmap", help="The map.")],
    sequence: Recording,
    out: MapOut,
    poses: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="Poses of the scans in the map (TUM or KITTI); see `segloc align`."
        ),
    ],
    select: Select = None,
    max_missed: Annotated[
        int,
        typer.Option(
            min=1, metavar="COUNT", help="Sessions in a row that must pass through what is removed."
        ),
    ] = 2,
    max_views: Annotated[
        int, typer.Option(min=0, metavar="COUNT", help="Newest views of an object; 0: all.")
    ] = 0,
    max_segments: Annotated[
        int, typer.Option(min=0, metavar="COUNT", help="Of the map at most; 0: any.")
    ] = 0,
    elsewhere: Elsewhere = False,
    topic: Topic = None,
    deskew: Deskew = True,
    config: ConfigFile = None,
    weights: Weights = None,
    threads: Threads = 0,
) -> None:
    """Add a session to a map, and remove what is no longer there.

    An object that the session's rays passed through is remembered as missed; what was not in view
    stays.
    """
    from ..map.segment_map import SegmentMap
    from ..map.update import UpdateConfig, update_map
    from .console import progress, table
    from .recording import open_recording
    from .saving import writing

    settings = UpdateConfig(max_missed=max_missed, max_views=max_views, max_segments=max_segments)
    with writing(out):
        prior = SegmentMap.load(prior_map)
        chosen = map_settings(prior, config, threads, weights)
        mount = chosen.local_cloud.mount
        recording = open_recording(sequence, poses, select, topic=topic, deskew=deskew, mount=mount)
        with progress("Looking at the map") as bar:
            updated, counts = update_map(
                prior, recording, chosen, settings, bar, elsewhere=elsewhere
            )
        updated.save(out)
    rows = [
        ("segments before", str(len(prior))),
        ("  seen again", str(counts.seen)),
        ("  missed", str(counts.aged)),
        ("  removed", str(counts.removed)),
        ("  not in view", str(counts.out_of_view)),
        ("segments added", str(counts.added)),
        ("segments dropped for size", str(counts.bounded)),
        ("segments now", str(len(updated))),
        ("points of the cloud removed", str(counts.points_removed)),
    ]
    table(str(out), ("", ""), rows)
