"""``segloc map update``"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...errors import ConfigError, DatasetError
from . import options
from .console import note, progress, table
from .shift import align_command, checked_shift, shift_rows

if TYPE_CHECKING:
    from ...config import Config
    from ...joining.shift import Shift
    from ...joining.update import UpdateConfig, UpdateCounts
    from ...map.segment_map import SegmentMap
    from ...tiles import TiledMap
    from ...types import Recording as Scans

    Opened = Callable[[SegmentMap | TiledMap], tuple[Config, Scans, Shift | None]]


def update(
    prior_map: Annotated[
        str, typer.Argument(metavar="MAP", help="The map: a file, or a folder or URL of tiles.")
    ],
    sequence: options.Recording,
    out: Annotated[
        str, typer.Option(metavar="MAP", help="Map to write; tiles are changed in place.")
    ],
    poses: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Poses of the scans in the map (TUM or KITTI); with --align, in any frame.",
            show_default="with --align, its own",
        ),
    ] = None,
    align: Annotated[
        bool, typer.Option("--align", help="First align the session's odometry to the map.")
    ] = False,
    odometry: options.Odometry = False,
    select: options.Select = None,
    max_missed: Annotated[
        int,
        typer.Option(
            min=1, metavar="COUNT", help="Sessions in a row that must miss an object to remove it."
        ),
    ] = 2,
    max_views: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="COUNT",
            help="Newest views of an object; 0: all.",
            show_default="twice those that a session keeps",
        ),
    ] = None,
    max_segments: Annotated[
        int, typer.Option(min=0, metavar="COUNT", help="Maximum size of the map; 0: unlimited.")
    ] = 0,
    elsewhere: options.Elsewhere = False,
    topic: options.Topic = None,
    deskew: options.Deskew = True,
    config: options.ConfigFile = None,
    weights: options.SameWeights = None,
    threads: options.Threads = 0,
    unchecked: options.Unchecked = False,
) -> None:
    """Add a session to a map, and remove objects that are gone.

    Objects that the session's rays pass through are counted as missed; those out of view stay. Only
    tiles within the session's reach are read and written. A session with odometry in its own frame
    is aligned to the map by --align. One that is 0.5 m or 1 degree off the map is rejected.
    """
    from ...joining.update import UpdateConfig
    from ...tiles import holds_tiles
    from .recording import open_recording

    settings = UpdateConfig(max_missed=max_missed, max_views=max_views, max_segments=max_segments)
    if poses is None and not align:
        raise ConfigError(
            "an update needs poses in the frame of the map: --poses FILE, or --align, which "
            "aligns the session's own"
        )

    remedy = _remedy(prior_map, sequence, poses, select, topic, align)

    def open_session(where: SegmentMap | TiledMap) -> tuple[Config, Scans, Shift | None]:
        """Return the settings of a map, and the session in its frame with its shift."""
        chosen = options.map_settings(where, config, threads, weights)
        local = chosen.local_cloud
        recording = open_recording(
            sequence, poses, select, topic=topic, deskew=deskew, odometry=odometry, local=local
        )
        if recording.poses is None:
            raise DatasetError(f"{sequence}: no poses: pass --poses FILE, or use --odometry")
        session = _align(recording, where, chosen) if align else recording
        shift = None if unchecked else checked_shift(where, session, sequence, remedy, chosen)
        return chosen, session, shift

    write = _update_tiles if holds_tiles(prior_map) else _update_map
    insists = {"elsewhere": elsewhere, "unchecked": unchecked}
    table(out, ("", ""), write(prior_map, out, open_session, settings, insists))


def _remedy(
    prior_map: str,
    sequence: Path,
    poses: Path | None,
    select: str | None,
    topic: str | None,
    aligned: bool,
) -> str:
    """Return what to do about a session that is off the map."""
    if aligned:
        return f"`segloc doctor {sequence}` checks its scans and poses"
    each = [poses] if poses else None, [select] if select else None
    command = align_command([prior_map, sequence], *each, topic)
    return f"{command} brings them into its frame, as --align here does"


def _align(recording: Scans, where: SegmentMap | TiledMap, config: Config) -> Scans:
    """Return a session with poses in the frame of a map."""
    from ...loops import align_to_map
    from ...types import Reposed
    from ..inspect.alignment import summary_to_map
    from .align import map_rows

    alignment = align_to_map(where, [recording], config, stage=progress)
    for name, line in map_rows(summary_to_map(alignment)):
        note(f"{name}: {line}")
    return Reposed(recording, alignment.poses[0])


def _update_map(
    prior_map: str, out: str, open_session: Opened, settings: UpdateConfig, insists: dict[str, bool]
) -> list[tuple[str, str]]:
    """Update a map file; return rows on what was done."""
    from ...joining.update import update_map
    from ...map.segment_map import SegmentMap
    from .results import writing

    target = Path(out)
    with writing(target):
        prior = SegmentMap.load(Path(prior_map))
        config, recording, shift = open_session(prior)
        with progress("Updating the map") as bar:
            updated, counts = update_map(
                prior, recording, config, settings, bar, shift=shift, **insists
            )
        updated.save(target)
    now = ("segments now", str(len(updated)))
    return [("segments before", str(len(prior))), *_rows(counts), now]


def _update_tiles(
    where: str, out: str, open_session: Opened, settings: UpdateConfig, insists: dict[str, bool]
) -> list[tuple[str, str]]:
    """Update tiles in place; return rows on what was done."""
    from ...tiles import TiledMap, update_tiles

    check_same_tiles(where, out)
    config, recording, shift = open_session(TiledMap(where))
    with progress("Updating the tiles") as bar:
        changed, counts = update_tiles(
            where, recording, config, settings, bar, shift=shift, **insists
        )
    tiles = f"{changed.written} of {len(changed.index.tiles)}"
    return [("tiles that changed", tiles), *_rows(counts)]


def check_same_tiles(where: str, out: str) -> None:
    """Reject another output than the tiles themselves."""
    if where.rstrip("/") != out.rstrip("/"):
        raise ConfigError(f"tiles are changed in place: use --out {where}, or copy them first")


def _rows(counts: UpdateCounts) -> list[tuple[str, str]]:
    return [
        *shift_rows(counts.shift),
        ("segments seen again", str(counts.seen)),
        ("segments missed", str(counts.aged)),
        ("segments removed", str(counts.removed)),
        ("segments not in view", str(counts.out_of_view)),
        ("segments added", str(counts.added)),
        ("segments dropped for size", str(counts.bounded)),
        ("points of the cloud removed", str(counts.points_removed)),
    ]
