"""``segloc localize``"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..system.text import counted
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
    from collections.abc import Sequence
    from concurrent.futures import Executor

    from ..batch.run import Priors
    from ..batch.score import Evaluation, Tolerance
    from ..localization import Localization
    from ..localizer import Localizer
    from ..map.segment_map import SegmentMap
    from ..prior import Prior
    from ..types import Float64, Int64, Pose
    from ..types import Recording as Scans
    from .console import Update


MapOrTiles = Annotated[
    str,
    typer.Option(
        "--map", metavar="MAP", help="The prior map: a file, or a folder or URL of tiles."
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Output folder.", show_default="none: results are printed"),
]
Debug = Annotated[
    bool, typer.Option("--debug", help="Also store the stages of each query for `segloc view`.")
]
Json = Annotated[bool, typer.Option("--json", help="Print everything as JSON.")]
MAX_ROWS = 20
_MOST = 0.5


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
    """Find the pose of a scan, or of each scan of a recording, in a map; no initial guess.

    With poses, a query is a cloud accumulated over the path behind it; otherwise one scan. Prints
    the pose and its confidence, or the reason why the query is not localized.
    """
    from ..batch.score import Tolerance
    from ..system.processes import executing
    from .console import busy, progress
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
    queries = Queries(localizer, prior_map, recording, positions, priors)
    with progress("Localizing") as update, executing(workers, cluster) as executor:
        results, kept = _in_detail(queries, update) if debug else (queries.by(executor, update), {})
    tolerance = Tolerance(tolerance_m, tolerance_deg)
    evaluation = queries.scored(results, prior.trajectory, truths, tolerance)
    _tell(queries, evaluation, name, out, kept, json)


def _check_out(out: Path | None, debug: bool, alone: bool) -> None:
    from ..errors import ConfigError
    from .results import check_folder

    if out is not None:
        check_folder(out)
    elif debug:
        raise ConfigError("--debug needs --out DIR, to store the stages of each query")
    if debug and not alone:
        raise ConfigError("--debug works in one process only: omit --workers and --cluster")


@dataclass(frozen=True)
class Queries:
    """Queries of a recording, and their map."""

    localizer: Localizer
    where: str
    recording: Scans
    positions: Int64
    near: Priors

    def by(self, executor: Executor | None, update: Update) -> list[Localization]:
        """Localize the queries in this process, or by an executor."""
        from ..batch.run import localize_parts, localize_sequence

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
        """Return the results with the true poses, if known."""
        from ..batch.score import Evaluation

        known = None if truths is None else truths[self.positions]
        indices = self.recording.indices[self.positions]
        return Evaluation(indices, results, path, known, tolerance)


def _in_detail(queries: Queries, update: Update) -> tuple[list[Localization], dict[str, bytes]]:
    """Localize the queries; return the results, and files of their stages."""
    from ..batch.run import each_prior, query_clouds
    from ..errors import ConfigError
    from ..inspect import trace
    from ..inspect.results import DEBUG, pack, stages_of

    localizer, recording = queries.localizer, queries.recording
    if localizer.tiles is not None:
        raise ConfigError("--debug needs a map file: it does not support tiles")
    results, kept = [], {}
    clouds = query_clouds(recording, queries.positions, localizer.config, localizer.clock)
    priors = each_prior(queries.near, len(queries.positions))
    indices = recording.indices[queries.positions]
    for index, (cloud, times), near in zip(indices, clouds, priors, strict=True):
        found = trace(localizer, cloud, f"{recording.name}, scan {index}", times, near)
        results.append(found.result)
        kept[f"{DEBUG}/{index}.npz"] = pack(stages_of(found))
        update(len(results), len(queries.positions))
    return results, kept


def _tell(
    queries: Queries,
    evaluation: Evaluation,
    name: str,
    out: Path | None,
    kept: dict[str, bytes],
    json: bool,
) -> None:
    """Write and show the results, with a hint on failures."""
    from ..doctor import hint
    from .console import busy, note
    from .results import write_results

    recording, localizer, written = queries.recording, queries.localizer, list[str]()
    if out is not None:
        title = f"{recording.name} in {Path(name).stem}"
        with busy("Drawing"):
            written = write_results(out, localizer.prior_map, evaluation, title, kept)
    _show_all(evaluation, f"{recording.name} in {name}", json)
    if written and not json:
        print(f"{out}: {', '.join(written)}")
    with busy("Diagnosing failures"):
        line = hint(
            recording,
            evaluation.results,
            localizer.config.local_cloud,
            prior_map=localizer.prior_map,
            known=_excluded(queries, evaluation.results),
        )
    if line:
        note(line)


def _show_all(evaluation: Evaluation, title: str, json: bool) -> None:
    """Print each result, and a summary of several."""
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
    """Return the positions of the queries; with --truth only those with a true pose."""
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
    """Print a summary as a table."""
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
    rows.append(("time per query, median", number(summary["ms"]["total"], "ms", 1)))
    table(title, ("", ""), rows)


def _grouped(reasons: dict[str, int]) -> list[tuple[str, int]]:
    """Count reasons without the numbers in brackets, the most frequent first."""
    counts: dict[str, int] = {}
    for reason, count in reasons.items():
        name = reason.split(" (")[0]
        counts[name] = counts.get(name, 0) + count
    return sorted(counts.items(), key=lambda item: -item[1])


def pose_text(T: Pose) -> str:
    """Format position and heading with units."""
    from .. import geometry

    x, y, z = (float(v) for v in T[:3, 3])
    yaw = math.degrees(geometry.heading(T))
    return f"x {x:.2f}, y {y:.2f}, z {z:.2f} m, yaw {yaw:.1f} deg"


def sentence(result: Localization) -> str:
    """Describe the result of a query in one line."""
    agree = counted(result.inliers, "segments", "agree")
    measured = f"{agree}, {result.overlap:.0%} of the cloud lies on the map"
    if result.proposer not in (None, "segments"):
        measured += f"; proposed by {result.proposer}"
    if result.localized:
        pose = pose_text(result.T_map_sensor)
        return f"localized at {pose}; confidence {result.confidence:.2f} ({measured})"
    return f"not localized: {result.message}; confidence {result.confidence:.2f}"


def show_answers(evaluation: Evaluation, title: str) -> None:
    """Print the result of one query as a line, of several as a table with the worst first."""
    from .console import table

    if len(evaluation) == 1:
        print(sentence(evaluation.results[0]))
        return
    order = worst_first(evaluation)
    rows = [_row(evaluation, i) for i in order[:MAX_ROWS]]
    table(title, ("query", "confidence", "pose / reason"), rows, texts=(0, 2))
    if len(order) > MAX_ROWS:
        print(f"{len(order) - MAX_ROWS} more with higher confidence; --out DIR or --json has all")


def worst_first(evaluation: Evaluation) -> Sequence[int]:
    """Order queries: false ones, those not localized, then the localized ones.

    False ones are sorted by falling confidence, the others by rising confidence; ties, as
    displayed, keep their order.
    """
    results, false = evaluation.results, evaluation.false

    def rank(i: int) -> tuple[int, float, int]:
        confidence = round(results[i].confidence, 2)
        if false[i]:
            return 0, -confidence, i
        return (2 if results[i].localized else 1), confidence, i

    return sorted(range(len(results)), key=rank)


def _row(evaluation: Evaluation, i: int) -> tuple[str, str, str]:
    result = evaluation.results[i]
    text = result.message if not result.localized else pose_text(result.T_map_sensor)
    if evaluation.false[i]:
        text = f"FALSE, {evaluation.translation_error[i]:.1f} m off: {text}"
    return str(int(evaluation.indices[i])), f"{result.confidence:.2f}", text


def gnss_priors(
    prior_map: SegmentMap,
    recording: Scans,
    positions: Int64,
    path: Path,
    near: Prior | None,
    radius: float,
) -> list[Prior | None]:
    """Make priors from the GNSS fixes of a bag; note how many queries have one.

    Raises
    ------
    ConfigError
        If the map has no georeference, or there is also a prior.
    """
    from ..batch.run import gnss_priors
    from ..datasets.fixes import read_fixes
    from ..errors import ConfigError
    from ..map.georeference import Georeference
    from .console import note

    georeference = Georeference.of(prior_map.metadata)
    if near is not None:
        raise ConfigError("--gnss and --near exclude each other")
    if georeference is None:
        raise ConfigError("--gnss needs a georeferenced map: build it with --epsg and --origin")
    fixes = read_fixes(path)
    stamps = None if recording.stamps is None else recording.stamps[positions]
    priors = gnss_priors(fixes, georeference, stamps, radius)
    count = sum(prior is not None for prior in priors)
    note(f"{fixes.source}: fixes for {count} of {len(priors)} queries; others search everywhere")
    return priors


def _excluded(queries: Queries, results: Sequence[Localization]) -> str | None:
    """Describe where the first query that a prior excludes is found without the prior."""
    from ..batch.run import each_prior, query_clouds
    from ..localization import Reason

    priors = each_prior(queries.near, len(results))
    excluded = [i for i, each in enumerate(results) if each.reason is Reason.NOT_NEAR_PRIOR]
    if len(excluded) <= _MOST * len(results):
        return None
    first, localizer = excluded[0], queries.localizer
    prior, position = priors[first], queries.positions[first : first + 1]
    ((cloud, _),) = query_clouds(queries.recording, position, localizer.config)
    anywhere = localizer.localize(cloud)
    if prior is None or not anywhere.localized:
        return None
    x, y = anywhere.T_map_sensor[:2, 3]
    away = float(prior.distances(anywhere.T_map_sensor[None, :3, 3])[0])
    return (
        f"the prior excludes them: query {queries.recording.indices[position[0]]} is at "
        f"{x:.1f}, {y:.1f}, {away:.0f} m from its centre (confidence {anywhere.confidence:.2f}). "
        "Correct the position, widen --radius, or add --anywhere"
    )
