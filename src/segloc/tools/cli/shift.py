"""Check that sessions and maps are in the frame of a map, and report by how much they are off."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .console import note, progress

if TYPE_CHECKING:
    from ...joining.shift import Session, Shift
    from ...map.config import BuildConfig
    from ...map.segment_map import SegmentMap
    from ...tiles import TiledMap

INSISTS = "--unchecked insists"


def checked_shift(
    prior_map: SegmentMap | TiledMap,
    session: Session,
    name: object,
    remedy: str,
    config: BuildConfig | None = None,
) -> Shift:
    """Measure the shift of a session against a map; note if it is unknown.

    Raises
    ------
    MapMismatch
        If it is too large.
    """
    from ...tiles.change import check_shift_in

    remedy = f"{remedy}; {INSISTS}"
    with progress("Localizing the session in the map") as bar:
        found = check_shift_in(
            prior_map, session, config, name=str(name), remedy=remedy, progress=bar
        )
    if found.remark:
        note(f"{name}: its poses are not compared with the map: {found.remark}")
    return found


def shift_rows(shift: Shift | None) -> list[tuple[str, str]]:
    """Describe a known shift."""
    if shift is None or not shift.is_known:
        return []
    median = f"{shift} (median of {shift.localized} places)"
    return [("off the map", median)]


def align_command(
    paths: Sequence[str | Path],
    poses: Sequence[Path] | None = None,
    select: Sequence[str] | None = None,
    topic: str | None = None,
) -> str:
    """Return the command that brings sessions into the frame of the first path."""
    words = ["segloc", "align", *map(str, paths)]
    given = {"--poses": poses, "--select": select, "--topic": [topic] if topic else None}
    for option, values in given.items():
        words += [word for value in values or [] for word in (option, str(value))]
    return f"`{shlex.join([*words, '--out', 'aligned'])}`"
