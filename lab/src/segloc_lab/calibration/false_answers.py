"""Draw the false answers in sealed worlds: each query at the answered pose, over the map.

The queries are localized again, so the code must be that of the answers (:mod:`.judge`).

    python -m segloc_lab.calibration.false_answers WORLDS posterior.jsonl --out false.png
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from segloc import Config, Localizer, SegmentMap, geometry
from segloc.tools.inspect import DARK, RED, blank, legend, png
from segloc.types import Float32, Pose

from ..pictures import query_over_map
from ..report import entries
from ..script import parser
from .judge import flat
from .rows import BARE, HOME, World, worlds_of

_AROUND_M, _COLUMNS, _PANEL_IN = 40.0, 3, 3.6


@dataclass(frozen=True)
class Drawn:
    """A false answer.

    Attributes
    ----------
    answer : dict
        Its row.
    prior_map : SegmentMap
    structure : (N, 3) float32
        Points of the query above ground, in the local frame.
    T_map_local, T_map_sensor : (4, 4) float64
        Answered poses.
    truth : (4, 4) float64 or None
        True pose, if the map holds it.
    """

    answer: dict[str, Any]
    prior_map: SegmentMap
    structure: Float32
    T_map_local: Pose
    T_map_sensor: Pose
    truth: Pose | None


def false_answers(world: World, answers: list[dict[str, Any]], config: Config) -> Iterator[Drawn]:
    """Localize the queries of false answers again."""
    queries = list(world.queries())
    maps = {answer["map"]: "own" if answer["map"] == BARE else answer["map"] for answer in answers}
    places = {name: Localizer(world.maps[of], config) for name, of in maps.items()}
    for answer in answers:
        made, localizer = queries[answer["query"]], places[answer["map"]]
        query = localizer.describe(made.scans)
        found = localizer.locate(query)
        if found.T_map_sensor is None:
            raise SystemExit(f"{world.name}, query {answer['query']}: refused by this code")
        yield Drawn(
            answer,
            localizer.prior_map,
            query.scene.structure,
            found.T_map_sensor @ geometry.inverse(query.cloud.T_local_sensor),
            found.T_map_sensor,
            made.truth if answer["map"] in HOME else None,
        )


def draw(found: list[Drawn]) -> bytes:
    """Draw false answers side by side, as a PNG image."""
    columns = min(_COLUMNS, len(found))
    rows = math.ceil(len(found) / columns)
    figure = blank((_PANEL_IN * columns, _PANEL_IN * rows), 110, layout="constrained")
    for axes, each in zip(figure.subplots(rows, columns, squeeze=False).flat, found, strict=False):
        middle = each.T_map_sensor[:2, 3]
        placed = each.prior_map, each.structure, each.T_map_local
        query_over_map(axes, *placed, middle, _AROUND_M)
        axes.plot(*middle, "o", color=RED, ms=5, label="sensor as answered")
        if each.truth is not None:
            axes.plot(*each.truth[:2, 3], "+", color=DARK, ms=9, label="sensor in truth")
        answer = each.answer
        axes.set_title(
            f"{answer['world']}, {answer['made']} {answer['query']} ({answer['sensor']})\n"
            f"map: {answer['map']}, confidence {answer['confidence']:.4f}",
            fontsize="x-small",
        )
    legend(figure.axes[0])
    for axes in figure.axes[len(found) :]:
        axes.set_axis_off()
    return png(figure)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("worlds", type=Path, help="folder of the worlds")
    options.add_argument("answers", type=Path, help="answers by judge")
    options.add_argument("--out", type=Path, required=True, help="PNG image")
    args = options.parse_args()
    false = [answer for answer in flat(entries(args.answers)) if answer["outcome"] == "false"]
    if not false:
        raise SystemExit("no answer is false")
    found: list[Drawn] = []
    for world in worlds_of(args.worlds):
        chosen = [answer for answer in false if answer["world"] == world.name]
        found += false_answers(world, chosen, Config(threads=1))
    args.out.write_bytes(draw(found))


if __name__ == "__main__":
    main()
