"""Localize the queries of a recording, and show the results."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...errors import ConfigError, DatasetError, SeglocError
from ...localization import Localization, Reason
from ...localizer import Localizer
from ...map.georeference import Georeference
from ...map.segment_map import SegmentMap
from ...prior import Prior
from ...system.files import write_text
from ...tiles import TiledLocalizer
from ...types import Float64, Int64, Recording
from ..batch import report, run
from ..batch.score import Evaluation
from ..datasets.fixes import read_fixes
from ..doctor import hint
from .console import Update, busy, note, table
from .results import pictures, print_json, write_results

_MAX_ROWS = 20
_MAX_EXCLUDED = 0.5  # share of queries, up to which the prior is not named as the cause


@dataclass(frozen=True)
class Queries:
    """Queries of a recording, and their map."""

    localizer: Localizer
    where: str
    recording: Recording
    positions: Int64
    near: run.Priors

    def first(self, count: int) -> Queries:
        """Return the first queries."""
        near = self.near if self.near is None or isinstance(self.near, Prior) else self.near[:count]
        return replace(self, positions=self.positions[:count], near=near)

    def localize(
        self, executor: Executor | None, update: Update
    ) -> tuple[list[Localization], SeglocError | None]:
        """Localize the queries in this process, or by an executor.

        In this process, answers are kept up to a scan that cannot be read; its fault comes second.
        """
        recording, positions, near = self.recording, self.positions, self.near
        if executor is not None:
            given = self.where, self.localizer.config, recording, positions, executor
            return run.localize_parts(*given, update, near), None
        results: list[Localization] = []
        try:
            for result in run.localized(self.localizer, recording, positions, near):
                results.append(result)
                update(len(results), len(positions))
        except DatasetError as error:
            if not results:
                raise
            return results, error
        return results, None


def localize_in_detail(
    queries: Queries, update: Update
) -> tuple[list[Localization], dict[str, bytes], SeglocError | None]:
    """Localize the queries; return the results, files of their stages, and a fault.

    The fault is as that of :meth:`Queries.localize`.
    """
    from ..inspect import trace
    from ..inspect.results import DEBUG, pack, stages_of

    localizer, recording = queries.localizer, queries.recording
    if isinstance(localizer, TiledLocalizer):
        raise ConfigError("--debug needs a map file: it does not support tiles")
    results, kept = list[Localization](), dict[str, bytes]()
    clouds = run.query_clouds(recording, queries.positions, localizer.config, localizer.clock)
    priors = run.each_prior(queries.near, len(queries.positions))
    indices = recording.indices[queries.positions]
    try:
        for index, (cloud, times), near in zip(indices, clouds, priors, strict=True):
            found = trace(localizer, cloud, f"{recording.name}, scan {index}", times, near)
            results.append(found.result)
            kept[f"{DEBUG}/{index}.npz"] = pack(stages_of(found))
            update(len(results), len(queries.positions))
    except DatasetError as error:
        if not results:
            raise
        return results, kept, error
    return results, kept, None


def query_positions(
    recording: Recording, truths: Float64 | None, every: float | None, max_gap_m: float
) -> Int64:
    """Return the positions of the queries; with --truth only those with a true pose."""
    scored = np.ones(len(recording), bool) if truths is None else np.isfinite(truths[:, 0, 0])
    if every is None:
        return np.flatnonzero(scored)
    path = recording.poses if recording.poses is not None else truths
    if path is None:
        raise ConfigError(
            "--every needs --poses, --odometry or --truth to measure the distance travelled"
        )
    positions = run.query_positions(path, every, max_gap_m)
    positions = positions[scored[positions]]
    if not len(positions):
        raise ConfigError(f"--every {every:g}: {recording.name} has no stretch of that length")
    return positions


def gnss_priors(
    prior_map: SegmentMap,
    recording: Recording,
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
    georeference = Georeference.of(prior_map.metadata)
    if near is not None:
        raise ConfigError("--gnss excludes --near and --height")
    if georeference is None:
        raise ConfigError("--gnss needs a georeferenced map: build it with --epsg and --origin")
    fixes = read_fixes(path)
    stamps = None if recording.stamps is None else recording.stamps[positions]
    priors = run.gnss_priors(fixes, georeference, stamps, radius)
    count = sum(prior is not None for prior in priors)
    note(f"{fixes.source}: fixes for {count} of {len(priors)} queries; others search everywhere")
    return priors


def show_results(
    queries: Queries,
    evaluation: Evaluation,
    name: str,
    out: Path | None,
    html: Path | None,
    kept: dict[str, bytes],
    json: bool,
) -> None:
    """Write and print the results, with a hint on failures."""
    recording, localizer, written = queries.recording, queries.localizer, list[str]()
    title, drawn = f"{recording.name} in {Path(name).stem}", dict[str, bytes]()
    if out is not None or html is not None:
        with busy("Drawing"):
            drawn = pictures(localizer.prior_map, evaluation, title)
    if out is not None:
        written = write_results(out, localizer.prior_map, evaluation, {**kept, **drawn})
    with busy("Diagnosing failures"):
        line = hint(
            recording,
            evaluation.results,
            localizer.config.local_cloud,
            prior_map=localizer.prior_map,
            known=_describe_excluded(queries, evaluation.results),
        )
    if html is not None:
        write_text(html, report.page(evaluation, title, drawn, [line] if line else []))
    if json:
        print_json(evaluation)
    else:
        _show_answers(evaluation, f"{recording.name} in {name}", whole=bool(written or html))
        if written:
            print(f"{out}: {', '.join(written)}")
        if html is not None:
            print(f"{html}: open it in a browser")
    if line:
        note(line)


def _show_answers(evaluation: Evaluation, title: str, *, whole: bool) -> None:
    """Print one result as a line, several as a table with the worst first and a summary.

    ``whole`` tells that files have all results.
    """
    if len(evaluation) == 1:
        print(report.sentence(evaluation.results[0]))
    else:
        order = report.worst_first(evaluation)
        rows = [report.answer_row(evaluation, i) for i in order[:_MAX_ROWS]]
        table(title, report.ANSWER_COLUMNS, rows, texts=(0, 2))
        if len(order) > _MAX_ROWS:
            more = f"{len(order) - _MAX_ROWS} more, surer ones"
            print(more if whole else f"{more}; --out DIR, --html FILE or --json has all")
    if len(evaluation) > 1 or evaluation.truths is not None:
        table(title, ("", ""), report.summary_rows(evaluation.summary()))


def _describe_excluded(queries: Queries, results: Sequence[Localization]) -> str | None:
    """Describe where the first query that a prior excludes is found without the prior."""
    priors = run.each_prior(queries.near, len(results))
    excluded = [i for i, each in enumerate(results) if each.reason is Reason.NOT_NEAR_PRIOR]
    if len(excluded) <= _MAX_EXCLUDED * len(results):
        return None
    first, localizer = excluded[0], queries.localizer
    prior, position = priors[first], queries.positions[first : first + 1]
    ((cloud, _),) = run.query_clouds(queries.recording, position, localizer.config)
    anywhere = localizer.localize(cloud)
    if prior is None or not anywhere.localized:
        return None
    x, y, z = anywhere.T_map_sensor[:3, 3]
    away = float(prior.distances(anywhere.T_map_sensor[None, :3, 3])[0])
    where = f"{x:.1f}, {y:.1f}, {z:.1f}"
    if prior.has_position:
        where += f", {away:.0f} m from its centre"
    return (
        f"the prior excludes them: query {queries.recording.indices[position[0]]} is at {where} "
        f"(confidence {anywhere.confidence:.2f}). Correct the prior, widen it, or add --anywhere"
    )
