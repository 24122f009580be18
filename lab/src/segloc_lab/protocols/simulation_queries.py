r"""Found, refused and false in simulated halls, storeys, mines, from the air and by other sensors.

    python -m segloc_lab.protocols.simulation_queries --work WORK --out results.json

Maps and scans are made once and kept in WORK; pieces that are in the results already are not
measured again. ``--only`` measures the scenarios whose names contain a word, ``--count`` queries a
seed. Right is within 3 m and 5 degrees, and within 1.5 m of the right height. Of every query that
is not found it is told what was missing: a level cloud (attitude), a candidate, or the verdict's
trust. Times are processor time of one thread.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Localizer, Scan, SegmentMap, geometry
from segloc.map.build import build_map
from segloc.system.files import replacing
from segloc.system.stage_times import StageTimes
from segloc.types import Candidate, Pose

from ..evaluation.intervals import share
from ..recordings import kept
from ..report import Cell, Table, publish
from ..script import reporting, row
from ..simulation import SimulatedSequence
from ..stages import processor_clock
from .simulation_scenarios import Scenario, scenarios, tilt_deg, within_a_second

METRES, DEGREES, HEIGHT_M = 3.0, 5.0, 1.5
SCANS = "scans"
"""The folder in WORK where scans are kept."""
ATTITUDE_DEG = 3.0
Row = dict[str, Any]


def prior_map(scenario: Scenario, seed: int, work: Path) -> SegmentMap:
    """The map of a scenario, made once."""
    path = work / "maps" / f"{scenario.map_name}-{seed}.segmap"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        config = Config().model_copy(update={"threads": 1})
        first, *others = (build_map(drive, config) for drive in scenario.map_drives(seed))
        for other in others:
            first = first.merge(other)
        first.save(path)
    return SegmentMap.load(path)


def localizer_of(scenario: Scenario, seed: int, work: Path) -> Localizer:
    """Of one thread, in the map of a scenario."""
    localizer = Localizer(prior_map(scenario, seed, work))
    config = localizer.config.model_copy(update={"threads": 1})
    return Localizer(localizer.prior_map, config)


def cloud_of(drive: SimulatedSequence, work: Path) -> list[Scan]:
    """The scans of one query: with odometry where there are several, and else without a pose."""
    cast = kept(drive, work / SCANS)
    scans = [cast.scan(i) for i in range(len(drive))]
    if len(scans) == 1:
        return [Scan(scans[0].points)]
    poses = within_a_second(drive).poses
    return [Scan(s.points, T_odom_sensor=T) for s, T in zip(scans, poses, strict=True)]


def errors(T: Pose, truth: Pose) -> tuple[float, float, float]:
    """Metres, degrees, and metres in height."""
    delta = geometry.inverse(truth) @ T
    angle = float(np.degrees(geometry.rotation_angle(delta)))
    return float(np.linalg.norm(delta[:3, 3])), angle, float(T[2, 3] - truth[2, 3])


def is_right(T: Pose, truth: Pose) -> bool:
    metres, degrees, high = errors(T, truth)
    return metres < METRES and degrees < DEGREES and abs(high) < HEIGHT_M


def measured(localizer: Localizer, scans: list[Scan], truth: Pose, within: bool) -> Row:
    """One answer, and of one that is not right what was missing."""
    watch = StageTimes(processor_clock)
    with watch("query"):
        result = localizer.localize(scans)
    found: Row = {
        "localized": result.localized,
        "reason": "" if result.localized else result.reason.name,
        "confidence": result.confidence,
        "inliers": result.inliers,
        "overlap": result.overlap,
        "seen": result.seen,
        "segments": result.counts["segments"],
        "tilt": tilt_deg(truth),
        "ms": watch.ms["query"],
        "times": dict(result.times_ms),
        "right": result.localized and within and is_right(result.T_map_sensor, truth),
    }
    if result.localized:
        found["errors"] = errors(result.T_map_sensor, truth)
    if not found["right"] and within:
        found |= missing(localizer, scans, truth)
    right = found["right"] or found.get("best_is_right")
    found["best"] = None if not result.confidence else "found" if right else "false"
    return found


def missing(localizer: Localizer, scans: list[Scan], truth: Pose) -> Row:
    """What kept a query within coverage from being found."""
    query = localizer.describe(scans)
    search = localizer.search(query)
    T_local_sensor = query.cloud.T_local_sensor
    up, true_up = T_local_sensor[2, :3], truth[2, :3]
    off = float(np.degrees(np.arccos(np.clip(up @ true_up, -1, 1))))
    T_map_local = truth @ geometry.inverse(T_local_sensor)
    rank = [k for k, c in enumerate(search.candidates) if is_right(c.T_map_local, T_map_local)]
    cloud = localizer.verifier.query(query.scene)
    at_truth = localizer.verifier.refined(Candidate(T_map_local, 0), cloud)
    best = search.verdict.best
    cause = "attitude" if off > ATTITUDE_DEG else "verdict" if rank else "candidate"
    return {
        "cause": cause,
        "attitude_off": off,
        "rank": rank[:1],
        "candidates": len(search.candidates),
        "by_segments": search.by_segments,
        "at_truth": [at_truth.overlap, at_truth.seen, at_truth.judged, at_truth.flush],
        "best_is_right": best is not None and is_right(best.T_map_local, T_map_local),
        "message": search.verdict.message,
        "features": _features(localizer, search.verdict.evidence),
    }


def _features(localizer: Localizer, evidence: Any) -> list[float]:
    if evidence is None:
        return []
    return [round(v, 2) for v in localizer.verifier.model.features(evidence)]


def piece(scenario: Scenario, seed: int, work: Path, count: int) -> Iterator[Row]:
    """The answers to the queries of one seed."""
    localizer = localizer_of(scenario, seed, work)
    within = scenario.expected != "refused"
    for drive, where in scenario.queries(seed, count):
        truth = drive.truth[-1]
        answer = measured(localizer, cloud_of(drive, work), truth, within)
        yield {"index": int(drive.indices[-1]) // 100, "where": where} | answer


COLUMNS = (
    "scenario",
    "expected",
    "found",
    "false",
    "on wrong floors",
    "ambiguous",
    "ms",
    "what those not found lack",
)


def cells(name: str, expected: str, rows: list[Row]) -> tuple[Cell, ...]:
    """A line of the table."""
    right = sum(r["right"] for r in rows)
    false = [r for r in rows if r["localized"] and not r["right"]]
    floors = sum(abs(r.get("errors", (0, 0, 0))[2]) > HEIGHT_M for r in false)
    ambiguous = sum(r["reason"] == "AMBIGUOUS" for r in rows)
    causes = [r["cause"] for r in rows if "cause" in r]
    told = ", ".join(f"{causes.count(c)} {c}" for c in sorted(set(causes)))
    ms = round(float(np.median([r["ms"] for r in rows])))
    asked = len(rows) if expected == "refused" else share(right, len(rows))
    return name, expected, asked, len(false), floors, ambiguous, ms, told or None


def table(results: Mapping[str, list[Row]]) -> list[tuple[Cell, ...]]:
    """One line a scenario, in mines one a kind of place."""
    lines: dict[tuple[str, str], list[Row]] = {}
    for key, rows in results.items():
        scenario = key.rsplit("/", 1)[0]
        for each in rows:
            name = " ".join(filter(None, [scenario, each["where"]]))
            lines.setdefault((name, scenarios()[scenario].expected), []).append(each)
    return [cells(*named, rows) for named, rows in lines.items()]


def report(results: Mapping[str, list[Row]], folder: Path | None) -> None:
    """Publish the table."""
    note = (
        "`profile`; in brackets 95 % by Wilson; where all should be refused, how many were asked. "
        "Right: within 3 m and 5 degrees, and 1.5 m in height. Milliseconds of processor time of "
        "one thread, on a machine with other work."
    )
    publish(folder, "Simulated places", Table(COLUMNS, table(results), note))


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("--work", type=Path, required=True, help="where maps and scans are kept")
    options.add_argument("--out", type=Path, required=True, help="results, JSON")
    options.add_argument("--only", nargs="*", default=[""], help="words in names of scenarios")
    options.add_argument("--count", type=int, default=10, help="queries a seed")
    args = options.parse_args()
    results = json.loads(args.out.read_text()) if args.out.exists() else {}
    for name, scenario in scenarios().items():
        if not any(word in name for word in args.only):
            continue
        for seed in scenario.seeds:
            key = f"{name}/{seed}"
            if key not in results:
                results[key] = list(piece(scenario, seed, args.work, args.count))
                with replacing(args.out) as stream:
                    stream.write(json.dumps(results, indent=1).encode())
                print(row(*cells(key, scenario.expected, results[key])), flush=True)
    report(results, args.report)


if __name__ == "__main__":
    main()
