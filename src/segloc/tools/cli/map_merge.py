"""``segloc map merge``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...errors import ConfigError, MapMismatch
from . import options
from .console import busy, table
from .shift import align_command, checked_shift, shift_rows

if TYPE_CHECKING:
    from ...map.segment_map import SegmentMap


def merge(
    maps: Annotated[
        list[str], typer.Argument(metavar="MAP", help="Two or more; the first may be tiles.")
    ],
    out: Annotated[
        str, typer.Option(metavar="MAP", help="Map to write; tiles are changed in place.")
    ],
    elsewhere: options.Elsewhere = False,
    unchecked: options.Unchecked = False,
) -> None:
    """Merge maps of one place that share their frame; common content is kept once.

    A map that is 0.5 m or 1 degree off the others is rejected.

    If the first map is tiles, the others are merged into them one by one; only tiles within their
    reach are written.
    """
    from ...config import map_config
    from ...map.compact import compacted
    from ...map.segment_map import SegmentMap
    from ...tiles import holds_tiles
    from .map_info import show
    from .results import writing

    if len(maps) < 2:
        raise ConfigError("merging needs at least two maps")
    if holds_tiles(maps[0]):
        _into_tiles(maps[0], [Path(path) for path in maps[1:]], out, elsewhere, unchecked)
        return
    paths = [Path(path) for path in maps]
    with writing(Path(out)):
        prior_map = _merge([SegmentMap.load(path) for path in paths], paths, elsewhere, unchecked)
        with busy("Merging"):
            prior_map = compacted(prior_map, map_config(prior_map).mapping.compact)
            prior_map.save(out)
    show(prior_map, out)


def _into_tiles(where: str, paths: list[Path], out: str, elsewhere: bool, unchecked: bool) -> None:
    from ...map.segment_map import SegmentMap
    from ...tiles import TiledMap, merge_into_tiles
    from .map_update import check_same_tiles

    check_same_tiles(where, out)
    rows = []
    for path in paths:
        other = SegmentMap.load(path)
        shift = None if unchecked else checked_shift(TiledMap(where), other, path, _remedy(where))
        with busy("Merging"):
            changed = merge_into_tiles(
                where, other, elsewhere=elsewhere, unchecked=unchecked, shift=shift
            )
        changes = f"{changed.written} of {len(changed.index.tiles)} tiles changed"
        rows += [(str(path), changes), *shift_rows(shift)]
    table(where, ("", ""), rows)


def _merge(
    maps: list[SegmentMap], paths: list[Path], elsewhere: bool, unchecked: bool
) -> SegmentMap:
    """Merge maps in an order in which each meets an earlier one, if possible."""
    from ...joining.same_place import check_same_place, meets

    merged, waiting, rows = maps[0], list(zip(maps[1:], paths[1:], strict=True)), []
    while waiting:
        chosen = next((each for each in waiting if meets(merged, each[0])), waiting[0])
        waiting.remove(chosen)
        other, path = chosen
        shift = None if unchecked else checked_shift(merged, other, path, _remedy(paths[0]))
        rows += [(str(path), value) for _, value in shift_rows(shift)]
        try:
            check_same_place(merged, other, elsewhere=elsewhere, unchecked=unchecked)
        except MapMismatch as error:
            raise MapMismatch(f"{path}: {error}") from error
        with busy("Merging"):
            merged = merged.merge(other)
    if rows:
        table("off the others", ("", ""), rows)
    return merged


def _remedy(where: str | Path) -> str:
    command = align_command([where, "RECORDING"])
    return f"{command} brings its recording into their frame; build it again with those poses"
