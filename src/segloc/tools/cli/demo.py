"""``segloc demo``"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...system.text import number
from .console import progress, table

if TYPE_CHECKING:
    from ...localizer import Localizer
    from ...sample import SampleDrive
    from ..batch.score import Evaluation

QUERY_EVERY_M = 4.0
"""Less than the spacing of the sample's scans: every scan except the first is a query."""

FAR_AWAY_M = 1e5
"""Offset of the other town in the map's frame, so that every answer is false."""


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Output folder.")] = Path("demo"),
) -> None:
    """Map the simulated sample, then localize a drive of another day, and one in another town.

    The second drive goes in the opposite direction, past other parked cars, and partly off the map.
    """
    from ... import sample
    from ...config import Config
    from ...localizer import Localizer
    from ...map.build import build_map
    from .results import check_folder, pictures, write_results

    check_folder(out)
    with progress("Building the map") as update:
        prior_map = build_map(sample.load("monday"), Config(), progress=update)
    localizer = Localizer(prior_map)
    again = _evaluate(localizer, sample.load("tuesday"), "Another day", 0.0)
    other = _evaluate(localizer, sample.load("elsewhere"), "Another town", FAR_AWAY_M)
    drawn = pictures(prior_map, again, "Another day in the mapped town")
    write_results(out / "revisit", prior_map, again, drawn)
    write_results(out / "elsewhere", prior_map, other, {})
    prior_map.save(out / "town.segmap")
    _show(again.summary(), other.summary(), f"The sample, descriptor {prior_map.descriptor}")
    picture = f", picture with the answers: {out}/revisit/trajectory.png" if drawn else ""
    print(f"Map: {out}/town.segmap{picture}")


def _evaluate(localizer: Localizer, drive: SampleDrive, label: str, shift_m: float) -> Evaluation:
    from ..batch.run import localize_sequence, query_positions
    from ..batch.score import Evaluation

    gap = localizer.config.local_cloud.max_gap_m
    positions = query_positions(drive.poses, QUERY_EVERY_M, gap)
    with progress(label) as update:
        results = localize_sequence(localizer, drive, positions, update)
    truths = drive.truth[positions].copy()
    truths[:, 0, 3] += shift_m
    return Evaluation(drive.indices[positions], results, localizer.prior_map, truths)


def _show(again: dict[str, Any], other: dict[str, Any], title: str) -> None:
    def row(name: str, count: Callable[[dict[str, Any]], int | str]) -> tuple[str, str, str]:
        return name, str(count(again)), str(count(other))

    rows = [
        row("queries", lambda s: s["queries"]),
        row("within map coverage", lambda s: s["within_coverage"]),
        row("  localized correctly", lambda s: s["within_coverage_correct"]),
        row(
            "localized correctly near the map",
            lambda s: s["correct"] - s["within_coverage_correct"],
        ),
        row("localized falsely", lambda s: s["false"]),
        row("refused", lambda s: s["not_localized"]),
        row("error, median", lambda s: number(s["translation_error_m"]["median"], "m")),
        row("time of a query, median", lambda s: number(s["ms"]["total"], "ms", 1)),
    ]
    table(title, ("", "another day", "another town"), rows)
