"""``segloc localize``"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import (
    Anywhere,
    Cluster,
    ConfigFile,
    Degrees,
    Deskew,
    Every,
    Gnss,
    Level,
    Metres,
    Near,
    Odometry,
    Poses,
    Radius,
    Recording,
    Select,
    Threads,
    Topic,
    Truth,
    Weights,
    Workers,
    check_every,
    opened_map,
    parsed_prior,
)

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from ..batch.run import Priors
    from ..batch.score import Evaluation, Tolerance
    from ..localization import Localization
    from ..localizer import Localizer
    from ..types import Float64, Int64
    from ..types import Recording as Scans
    from .console import Update


MapOrTiles = Annotated[
    str, typer.Option("--map", metavar="MAP", help="The prior map: a file, or the place of tiles.")
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="A folder to write results to.", show_default="none: they are printed"
    ),
]
Debug = Annotated[
    bool, typer.Option("--debug", help="Also keep what `segloc view` shows of each query.")
]
Json = Annotated[bool, typer.Option("--json", help="All of it on stdout, for programs.")]


def localize(
    sequence: Recording,
    prior_map: MapOrTiles,
    out: Out = None,
    debug: Debug = False,
    json: Json = False,
    poses: Poses = None,
    select: Select = None,
    every: Every = None,
    truth: Truth = None,
    tolerance_m: Metres = 3.0,
    tolerance_deg: Degrees = 5.0,
    near: Near = None,
    radius: Radius = 50.0,
    anywhere: Anywhere = False,
    gnss: Gnss = False,
    topic: Topic = None,
    deskew: Deskew = True,
    odometry: Odometry = False,
    level: Level = False,
    config: ConfigFile = None,
    weights: Weights = None,
    threads: Threads = 0,
    workers: Workers = 1,
    cluster: Cluster = None,
) -> None:
    """Find a scan, or each of a recording, in a map: without an initial guess.

    With poses, a query is a cloud gathered over the path behind it; otherwise one scan. Prints the
    pose and how sure it is, or why there is none.
    """
    from ..batch.score import Tolerance
    from ..system.processes import executing
    from .console import busy, progress
    from .gnss import gnss_priors
    from .recording import levelled_poses, open_recording, place_of_sensor, true_poses

    check_every(every)
    place = parsed_prior(near, radius, anywhere)
    _check_out(out, debug, alone=workers == 1 and cluster is None)
    with busy("Loading the map"):
        localizer, prior, name = opened_map(prior_map, config, threads, weights)
    sequence = sequence.absolute() if cluster else sequence
    mount = localizer.config.local_cloud.mount
    recording: Scans = open_recording(
        sequence, poses, select, topic=topic, deskew=deskew, odometry=odometry, mount=mount
    )
    recording = levelled_poses(recording, localizer.config.local_cloud, level)
    truths = true_poses(recording, sequence, truth, topic, place_of_sensor(mount))
    positions = _positions(recording, truths, every, localizer.config.local_cloud.max_gap_m)
    priors = gnss_priors(prior, recording, positions, sequence, place, radius) if gnss else place
    asked = _Asked(localizer, prior_map, recording, positions, priors)
    with progress("Localizing") as update, executing(workers, cluster) as executor:
        results, kept = _in_detail(asked, update) if debug else (asked.by(executor, update), {})
    tolerance = Tolerance(tolerance_m, tolerance_deg)
    evaluation = asked.scored(results, prior.trajectory, truths, tolerance)
    _tell(asked, evaluation, name, out, kept, json)


def _check_out(out: Path | None, debug: bool, alone: bool) -> None:
    from ..errors import ConfigError
    from .results import check_folder

    if out is not None:
        check_folder(out)
    elif debug:
        raise ConfigError("--debug needs --out DIR, to keep what each stage made there")
    if debug and not alone:
        raise ConfigError("--debug keeps more than workers hand back: leave one of them out")


@dataclass(frozen=True)
class _Asked:
    """Queries of a recording, and where they are localized."""

    localizer: Localizer
    where: str
    recording: Scans
    positions: Int64
    near: Priors

    def by(self, executor: Executor | None, update: Update) -> list[Localization]:
        """The answers, made here or by others."""
        from ..batch.parts import localize_parts
        from ..batch.run import localize_sequence

        recording, positions, near = self.recording, self.positions, self.near
        if executor is None:
            return localize_sequence(self.localizer, recording, positions, update, near)
        config = self.localizer.config
        return localize_parts(self.where, config, recording, positions, executor, update, near)

    def scored(
        self,
        results: list[Localization],
        path: Float64,
        truths: Float64 | None,
        tolerance: Tolerance,
    ) -> Evaluation:
        """The answers beside the truth, where it is known."""
        from ..batch.score import Evaluation

        known = None if truths is None else truths[self.positions]
        indices = self.recording.indices[self.positions]
        return Evaluation(indices, results, path, known, tolerance)


def _in_detail(asked: _Asked, update: Update) -> tuple[list[Localization], dict[str, bytes]]:
    """The answers, and files of what each stage made of each query."""
    from ..batch.run import each_prior, query_clouds
    from ..errors import ConfigError
    from ..inspect import trace
    from ..inspect.results import DEBUG
    from ..inspect.seen import packed, seen

    localizer, recording = asked.localizer, asked.recording
    if localizer.tiles is not None:
        raise ConfigError("--debug needs a map file: what tiles hold is not kept")
    results, kept = [], {}
    clouds = query_clouds(recording, asked.positions, localizer.config, localizer.clock)
    priors = each_prior(asked.near, len(asked.positions))
    indices = recording.indices[asked.positions]
    for index, (cloud, times), near in zip(indices, clouds, priors, strict=True):
        found = trace(localizer, cloud, f"{recording.name}, scan {index}", times, near)
        results.append(found.result)
        kept[f"{DEBUG}/{index}.npz"] = packed(seen(found))
        update(len(results), len(asked.positions))
    return results, kept


def _tell(
    asked: _Asked,
    evaluation: Evaluation,
    name: str,
    out: Path | None,
    kept: dict[str, bytes],
    json: bool,
) -> None:
    """Write and show the answers, and a hint where there is one."""
    from .console import busy, note
    from .hints import hint
    from .results import write_results

    recording, localizer, written = asked.recording, asked.localizer, list[str]()
    if out is not None:
        title = f"{recording.name} in {Path(name).stem}"
        with busy("Drawing"):
            written = write_results(out, localizer.prior_map, evaluation, title, kept)
    _show_all(evaluation, f"{recording.name} in {name}", json)
    if written and not json:
        print(f"{out} has {', '.join(written)}")
    with busy("Looking why"):
        line = hint(recording, evaluation.results, localizer.config.local_cloud)
    if line:
        note(line)


def _show_all(evaluation: Evaluation, title: str, json: bool) -> None:
    """Each answer, and of several a summary."""
    from .answers import show_answers
    from .results import print_json

    if json:
        print_json(evaluation)
        return
    show_answers(evaluation, title)
    if len(evaluation) > 1 or evaluation.truths is not None:
        show(evaluation.summary(), title)


def _positions(
    recording: Scans, truths: Float64 | None, every: float | None, max_gap_m: float
) -> Int64:
    """Positions of the queries; with a truth those whose true pose is known."""
    import numpy as np

    from ..batch.run import query_positions
    from ..errors import ConfigError

    scored = np.ones(len(recording), bool) if truths is None else np.isfinite(truths[:, 0, 0])
    if every is None:
        return np.flatnonzero(scored)
    path = recording.poses if recording.poses is not None else truths
    if path is None:
        raise ConfigError(
            "--every needs --poses, --odometry or --truth to measure the distance travelled"
        )
    positions = query_positions(path, every, max_gap_m)
    positions = positions[scored[positions]]
    if not len(positions):
        raise ConfigError(f"--every {every:g}: {recording.name} has no stretch of that length")
    return positions


def show(summary: dict[str, Any], title: str) -> None:
    """Print a summary as one table."""
    from .console import number, table
    from .results import error_rows

    sources = ", ".join(f"{count} {name}" for name, count in summary["attitude"].items())
    rows = [("queries", str(summary["queries"])), ("roll and pitch", sources or "-")]
    rows.append(("localized", str(summary["localized"])))
    if summary["correct"] is not None:
        rows += [("  correct", str(summary["correct"])), ("  false", str(summary["false"]))]
        found = f"{summary['within_coverage_correct']} of {summary['within_coverage']}"
        rows.append(("correct, of those within map coverage", found))
        rows += error_rows(summary)
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
