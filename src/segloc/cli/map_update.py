"""``segloc map update``"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import (
    ConfigFile,
    Deskew,
    Elsewhere,
    Odometry,
    Recording,
    Select,
    Threads,
    Topic,
    Weights,
    map_settings,
)

if TYPE_CHECKING:
    from ..config import Config
    from ..map.segment_map import SegmentMap
    from ..map.update import UpdateConfig, UpdateCounts
    from ..tiles import TiledMap
    from ..types import Recording as Scans

PosesInMap = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Poses of the scans in the map (TUM or KITTI); with --align, in any frame.",
        show_default="with --align, its own",
    ),
]
Align = Annotated[
    bool, typer.Option("--align", help="First align the session's odometry to the map.")
]


def update(
    prior_map: Annotated[
        str, typer.Argument(metavar="MAP", help="The map: a file, or a folder or URL of tiles.")
    ],
    sequence: Recording,
    out: Annotated[
        str, typer.Option(metavar="MAP", help="Map to write; tiles are changed in place.")
    ],
    poses: PosesInMap = None,
    align: Align = False,
    odometry: Odometry = False,
    select: Select = None,
    max_missed: Annotated[
        int,
        typer.Option(
            min=1, metavar="COUNT", help="Sessions in a row that must miss an object to remove it."
        ),
    ] = 2,
    max_views: Annotated[
        int, typer.Option(min=0, metavar="COUNT", help="Newest views of an object; 0: all.")
    ] = 0,
    max_segments: Annotated[
        int, typer.Option(min=0, metavar="COUNT", help="Maximum size of the map; 0: unlimited.")
    ] = 0,
    elsewhere: Elsewhere = False,
    topic: Topic = None,
    deskew: Deskew = True,
    config: ConfigFile = None,
    weights: Weights = None,
    threads: Threads = 0,
) -> None:
    """Add a session to a map, and remove objects that are gone.

    Objects that the session's rays pass through are counted as missed; those out of view stay. Only
    tiles within the session's reach are read and written. A session with odometry in its own frame
    is aligned to the map by --align, or rejected.
    """
    from ..map.update import UpdateConfig
    from ..tiles import holds_tiles
    from .console import table

    settings = UpdateConfig(max_missed=max_missed, max_views=max_views, max_segments=max_segments)
    session = _SessionInput(
        sequence=sequence,
        poses=poses,
        align=align,
        odometry=odometry,
        select=select,
        topic=topic,
        deskew=deskew,
        config=config,
        weights=weights,
        threads=threads,
        elsewhere=elsewhere,
    )
    if holds_tiles(prior_map):
        rows = session.into_tiles(prior_map, out, settings)
    else:
        rows = session.into_map(Path(prior_map), Path(out), settings)
    table(out, ("", ""), rows)


@dataclass(frozen=True)
class _SessionInput:
    """A session, and the options for reading it."""

    sequence: Path
    poses: Path | None
    align: bool
    odometry: bool
    select: str | None
    topic: str | None
    deskew: bool
    config: Path | None
    weights: Path | None
    threads: int
    elsewhere: bool

    def __post_init__(self) -> None:
        from ..errors import ConfigError

        if self.poses is None and not self.align:
            raise ConfigError(
                "an update needs poses in the frame of the map: --poses FILE, or --align, which "
                "aligns the session's own"
            )

    def _opened(self, where: SegmentMap | TiledMap) -> tuple[Config, Scans]:
        """Return the settings of a map, and the session in its frame."""
        from ..loops import Reposed, align_to_map
        from ..map.segment_map import SegmentMap
        from .align import map_rows
        from .console import note, progress
        from .recording import open_recording

        prior_map = where if isinstance(where, SegmentMap) else where.coarse()
        chosen = map_settings(prior_map, self.config, self.threads, self.weights)
        recording = open_recording(
            self.sequence,
            self.poses,
            self.select,
            topic=self.topic,
            deskew=self.deskew,
            odometry=self.odometry,
            mount=chosen.local_cloud.mount,
        )
        if not self.align:
            return chosen, recording
        alignment = align_to_map(where, [recording], chosen, stage=progress)
        for name, line in map_rows(alignment):
            note(f"{name}: {line}")
        return chosen, Reposed(recording, alignment.poses[0])

    def into_map(self, prior_map: Path, out: Path, settings: UpdateConfig) -> list[tuple[str, str]]:
        """Update a map file; return rows on what was done."""
        from ..map.segment_map import SegmentMap
        from ..map.update import update_map
        from .console import progress
        from .results import writing

        with writing(out):
            prior = SegmentMap.load(prior_map)
            chosen, recording = self._opened(prior)
            with progress("Updating the map") as bar:
                updated, counts = update_map(
                    prior, recording, chosen, settings, bar, elsewhere=self.elsewhere
                )
            updated.save(out)
        now = ("segments now", str(len(updated)))
        return [("segments before", str(len(prior))), *_rows(counts), now]

    def into_tiles(self, where: str, out: str, settings: UpdateConfig) -> list[tuple[str, str]]:
        """Update tiles in place; return rows on what was done."""
        from ..tiles import TiledMap, update_tiles
        from .console import progress

        check_same_tiles(where, out)
        chosen, recording = self._opened(TiledMap(where))
        with progress("Updating the tiles") as bar:
            changed, counts = update_tiles(
                where, recording, chosen, settings, bar, elsewhere=self.elsewhere
            )
        tiles = f"{changed.written} of {len(changed.index.tiles)}"
        return [("tiles that changed", tiles), *_rows(counts)]


def check_same_tiles(where: str, out: str) -> None:
    """Reject another output than the tiles themselves.

    Raises
    ------
    ConfigError
    """
    from ..errors import ConfigError

    if where.rstrip("/") != out.rstrip("/"):
        raise ConfigError(f"tiles are changed in place: use --out {where}, or copy them first")


def _rows(counts: UpdateCounts) -> list[tuple[str, str]]:
    return [
        ("  seen again", str(counts.seen)),
        ("  missed", str(counts.aged)),
        ("  removed", str(counts.removed)),
        ("  not in view", str(counts.out_of_view)),
        ("segments added", str(counts.added)),
        ("segments dropped for size", str(counts.bounded)),
        ("points of the cloud removed", str(counts.points_removed)),
    ]
