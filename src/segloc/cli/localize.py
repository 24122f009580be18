"""``segloc localize``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import (
    Anywhere,
    ConfigFile,
    Deskew,
    Every,
    Level,
    Near,
    Odometry,
    Poses,
    Radius,
    Recording,
    Select,
    Threads,
    Topic,
    Weights,
    check_every,
    opened_map,
    parsed_prior,
)

if TYPE_CHECKING:
    from ..types import Float64, Int64
    from ..types import Recording as Scans


def localize(
    sequence: Recording,
    prior_map: Annotated[
        str,
        typer.Option("--map", metavar="MAP", help="The prior map: a file, or the place of tiles."),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="The folder to write results to.")],
    poses: Poses = None,
    select: Select = None,
    every: Every = None,
    truth: Annotated[
        Path | None, typer.Option(help="True poses in the map's frame, to score against.")
    ] = None,
    tolerance_m: Annotated[float, typer.Option(min=0, help="Farther off is false.")] = 3.0,
    tolerance_deg: Annotated[float, typer.Option(min=0, help="Turned further is false.")] = 5.0,
    near: Near = None,
    radius: Radius = 50.0,
    anywhere: Anywhere = False,
    topic: Topic = None,
    deskew: Deskew = True,
    odometry: Odometry = False,
    level: Level = False,
    config: ConfigFile = None,
    weights: Weights = None,
    threads: Threads = 0,
) -> None:
    """Find the scans of a recording in a map, each by itself and without an initial guess.

    With poses, a query is a cloud gathered over the path behind it; otherwise one scan.
    """
    from ..batch.run import localize_sequence
    from ..batch.score import Evaluation, Tolerance
    from ..datasets import poses_at
    from .console import progress
    from .recording import levelled_poses, open_recording, place_of_sensor
    from .results import check_folder, write_results

    check_every(every)
    prior_position = parsed_prior(near, radius, anywhere)
    check_folder(out)
    localizer, prior, name = opened_map(prior_map, config, threads, weights)
    mount = localizer.config.local_cloud.mount
    recording: Scans = open_recording(
        sequence, poses, select, topic=topic, deskew=deskew, odometry=odometry, mount=mount
    )
    recording = levelled_poses(recording, localizer.config.local_cloud, level)
    T = place_of_sensor(mount)
    truths = poses_at(recording, sequence, truth, topic, T_base_sensor=T) if truth else None
    gap = localizer.config.local_cloud.max_gap_m
    positions = _positions(recording, truths, every, gap)
    with progress("Localizing") as update:
        results = localize_sequence(localizer, recording, positions, update, prior_position)
    evaluation = Evaluation(
        recording.indices[positions],
        results,
        prior.trajectory,
        None if truths is None else truths[positions],
        Tolerance(tolerance_m, tolerance_deg),
    )
    write_results(out, prior, evaluation, f"{recording.name} in {Path(name).stem}")
    show(evaluation.summary(), f"{recording.name} in {name}")


def _positions(
    recording: Scans, truths: Float64 | None, every: float | None, max_gap_m: float
) -> Int64:
    import numpy as np

    from ..batch.run import query_positions
    from ..errors import ConfigError

    if every is None:
        return np.arange(len(recording), dtype=np.int64)
    path = recording.poses if recording.poses is not None else truths
    if path is None:
        raise ConfigError(
            "--every needs --poses, --odometry or --truth to measure the distance travelled"
        )
    positions = query_positions(path, every, max_gap_m)
    if not len(positions):
        raise ConfigError(f"--every {every:g}: {recording.name} has no stretch of that length")
    return positions


def show(summary: dict[str, Any], title: str) -> None:
    """Print a summary as one table."""
    from .console import number, table

    sources = ", ".join(f"{count} {name}" for name, count in summary["attitude"].items())
    rows = [("queries", str(summary["queries"])), ("roll and pitch", sources or "-")]
    rows.append(("localized", str(summary["localized"])))
    if summary["correct"] is not None:
        rows += [("  correct", str(summary["correct"])), ("  false", str(summary["false"]))]
        found = f"{summary['within_coverage_correct']} of {summary['within_coverage']}"
        rows.append(("correct, of those within map coverage", found))
        for kind, unit in (("translation", "m"), ("rotation", "deg")):
            spread = summary[f"{kind}_error_{unit}"]
            pair = f"{number(spread['median'], unit)} / {number(spread['p95'], unit)}"
            rows.append((f"{kind} error, median / 95 %", pair))
    rows.append(("not localized", str(summary["not_localized"])))
    rows += [(f"  {reason}", str(n)) for reason, n in _grouped(summary["reasons"])]
    rows.append(("time of a query, median", number(summary["ms"]["total"], "ms", 1)))
    table(title, ("", ""), rows)


def _grouped(reasons: dict[str, int]) -> list[tuple[str, int]]:
    """Reasons without the numbers in their brackets, the commonest first."""
    counts: dict[str, int] = {}
    for reason, count in reasons.items():
        name = reason.split(" (")[0]
        counts[name] = counts.get(name, 0) + count
    return sorted(counts.items(), key=lambda item: -item[1])
