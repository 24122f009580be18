"""``segloc map info``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..system.text import counted
from .console import table

if TYPE_CHECKING:
    from ..map.georeference import Georeference
    from ..map.segment_map import SegmentMap

_MAX_TEXT = 200


def info(
    path: Annotated[Path, typer.Argument(metavar="MAP.segmap", help="The map.")],
    json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Show the contents of a map, and check the file for damage."""
    from ..map.segment_map import SegmentMap

    prior_map = SegmentMap.load(path)
    if json:
        from json import dumps

        print(dumps(prior_map.info(), indent=2, ensure_ascii=False, allow_nan=False))
    else:
        show(prior_map, str(path))


def save_and_show(prior_map: SegmentMap, out: Path, where: Georeference | None) -> None:
    """Save a new map with its georeference, and print its contents."""
    from ..map.georeference import KEY
    from .results import writing

    if where is not None:
        prior_map.metadata[KEY] = where.to_text()
    with writing(out):
        prior_map.save(out)
    show(prior_map, str(out))


def _poses_rows(prior_map: SegmentMap, sessions: str) -> list[tuple[str, str]]:
    """Return rows of the poses that a sensor had, and of viewpoints chosen in a cloud."""
    from ..map.segment_map import LATTICE, VIEWPOINTS

    driven = int(prior_map.is_driven.sum())
    chosen = len(prior_map.trajectory) - driven
    rows = [("poses", f"{driven} in {sessions}")] if driven or not chosen else []
    if chosen:
        lattice = LATTICE in prior_map.metadata.get(VIEWPOINTS, "")
        where = "on a lattice, since there is no ground" if lattice else "on free ground"
        rows.append(("viewpoints", f"{chosen} {where}"))
    return rows


def show(prior_map: SegmentMap, title: str) -> None:
    """Print a table of a map's contents."""
    from ..map.georeference import Georeference
    from ..map.segment_map import CLOUD, SOURCE

    facts = prior_map.info()
    sessions = counted(facts["sessions"], "sessions")
    extent = " x ".join(f"{metres:.0f}" for metres in facts["extent_m"])
    rows = [
        ("descriptor", f"{facts['descriptor']}, {facts['dim']} numbers ({facts['fingerprint']})"),
        ("segments", f"{facts['segments']}"),
        *_poses_rows(prior_map, sessions),
        ("cloud", f"{facts['cloud_points']} points, one per {facts['cloud_voxel_m']:g} m"),
        ("extent", f"{extent} m"),
        ("in memory", f"{facts['memory_bytes'] / 1e6:.1f} MB"),
    ]
    if CLOUD in prior_map.metadata.get(SOURCE, ""):
        spacing = prior_map.metadata.get("cloud_spacing_m", "unknown")
        rows.append(("made from", f"a cloud, points {spacing[:_MAX_TEXT]} m apart"))
    if frame := prior_map.metadata.get("frame"):
        rows.append(("frame", frame[:_MAX_TEXT]))
    if (where := Georeference.of(prior_map.metadata)) is not None:
        rows.append(("georeference", str(where)))
    table(title, ("", ""), rows)
