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
    Recording,
    Select,
    Threads,
    Topic,
    Weights,
    map_settings,
)

if TYPE_CHECKING:
    from ..config import Config
    from ..datasets import Sequence
    from ..map.segment_map import SegmentMap
    from ..map.update import UpdateConfig, UpdateCounts


def update(
    prior_map: Annotated[
        str, typer.Argument(metavar="MAP", help="The map: a file, or the place of tiles.")
    ],
    sequence: Recording,
    out: Annotated[
        str, typer.Option(metavar="MAP", help="The file to write; tiles change where they lie.")
    ],
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
    stays. Of tiles only those are read and written that the session reaches.
    """
    from ..map.update import UpdateConfig
    from ..tiles import holds_tiles
    from .console import table

    settings = UpdateConfig(max_missed=max_missed, max_views=max_views, max_segments=max_segments)
    asked = _Asked(sequence, poses, select, topic, deskew, config, weights, threads, elsewhere)
    if holds_tiles(prior_map):
        rows = asked.into_tiles(prior_map, out, settings)
    else:
        rows = asked.into_map(Path(prior_map), Path(out), settings)
    table(out, ("", ""), rows)


@dataclass(frozen=True)
class _Asked:
    """A session, and how it is read."""

    sequence: Path
    poses: Path
    select: str | None
    topic: str | None
    deskew: bool
    config: Path | None
    weights: Path | None
    threads: int
    elsewhere: bool

    def _opened(self, prior_map: SegmentMap) -> tuple[Config, Sequence]:
        """The session, and the settings by which a map was built."""
        from .recording import open_recording

        chosen = map_settings(prior_map, self.config, self.threads, self.weights)
        return chosen, open_recording(
            self.sequence,
            self.poses,
            self.select,
            topic=self.topic,
            deskew=self.deskew,
            mount=chosen.local_cloud.mount,
        )

    def into_map(self, prior_map: Path, out: Path, settings: UpdateConfig) -> list[tuple[str, str]]:
        """Update a map file, and say what was done."""
        from ..map.segment_map import SegmentMap
        from ..map.update import update_map
        from .console import progress
        from .results import writing

        with writing(out):
            prior = SegmentMap.load(prior_map)
            chosen, recording = self._opened(prior)
            with progress("Looking at the map") as bar:
                updated, counts = update_map(
                    prior, recording, chosen, settings, bar, elsewhere=self.elsewhere
                )
            updated.save(out)
        now = ("segments now", str(len(updated)))
        return [("segments before", str(len(prior))), *_told(counts), now]

    def into_tiles(self, where: str, out: str, settings: UpdateConfig) -> list[tuple[str, str]]:
        """Update tiles where they lie, and say what was done."""
        from ..tiles import TiledMap, update_tiles
        from .console import progress

        check_same_tiles(where, out)
        chosen, recording = self._opened(TiledMap(where).coarse())
        with progress("Looking at the tiles") as bar:
            changed, counts = update_tiles(
                where, recording, chosen, settings, bar, elsewhere=self.elsewhere
            )
        tiles = f"{changed.written} of {len(changed.index.tiles)}"
        return [("tiles that changed", tiles), *_told(counts)]


def check_same_tiles(where: str, out: str) -> None:
    """Refuse to write tiles elsewhere than they lie.

    Raises
    ------
    ConfigError
    """
    from ..errors import ConfigError

    if where.rstrip("/") != out.rstrip("/"):
        raise ConfigError(f"tiles change where they lie: --out {where}, or copy them first")


def _told(counts: UpdateCounts) -> list[tuple[str, str]]:
    return [
        ("  seen again", str(counts.seen)),
        ("  missed", str(counts.aged)),
        ("  removed", str(counts.removed)),
        ("  not in view", str(counts.out_of_view)),
        ("segments added", str(counts.added)),
        ("segments dropped for size", str(counts.bounded)),
        ("points of the cloud removed", str(counts.points_removed)),
    ]
