"""A whole query: from the scan to the verified pose, in small and in large maps."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from segloc import SegmentMap, build_map, geometry
from segloc.config import Config
from segloc.errors import SeglocError
from segloc.localization import Localization
from segloc.localizer import Localizer
from segloc.map import DEFAULT_METHOD
from segloc.system.stage_times import Clock, StageTimes
from segloc.types import LocalCloud, Pose, Scan

from ..padding import padded_with_copies
from ..stages import clock_for, single_pass
from . import harness
from .harness import OURS, Row, optional, row

if TYPE_CHECKING:
    from segloc.datasets import Recording

MAP_SEGMENTS = 50_000
KISS_VOXEL_M = 1.0
ELSEWHERE = "elsewhere"
_STREET_M = 100.0
_TOWN_M = 200.0


@dataclass(frozen=True)
class Scene:
    """A map, scans to find in it, and a mapped scan near the first of them.

    Attributes
    ----------
    queries : list of (Scan or LocalCloud, Pose)
        Without a pose in the map, and their true T_map_sensor.
    mapped : Scan
        What a scan-to-scan method is given in place of the map.
    elsewhere : list of Scan or LocalCloud
        Of places that the map does not hold.
    """

    prior_map: SegmentMap
    queries: list[tuple[Scan | LocalCloud, Pose]]
    mapped: Scan
    elsewhere: list[Scan | LocalCloud] = field(default_factory=list)


def query(threads: int, repeats: int) -> Row:
    """Single scans in a map of 50 000 segments, most of them of other places."""
    return query_row("query", simulated_scene(threads), threads, repeats, segments=MAP_SEGMENTS)


def query_row(
    name: str,
    scene: Scene,
    threads: int,
    repeats: int,
    *,
    segments: int,
    tolerance_m: float = 3.0,
    rivals: bool = True,
) -> Row:
    """Localize the scans of a scene whose map is padded to ``segments``."""
    prior_map = padded_with_copies(scene.prior_map, segments)
    localizer = Localizer(
        prior_map, Config.preset(prior_map.descriptor).model_copy(update={"threads": threads})
    )
    answers: list[Localization] = []
    refused: list[Localization] = []

    def localize() -> None:
        answers[:] = [localizer.localize(scan) for scan, _ in scene.queries]

    def refuse() -> None:
        refused[:] = map(localizer.localize, scene.elsewhere)

    runs: dict[str, Callable[[], object]] = {OURS: localize}
    if scene.elsewhere:
        runs[ELSEWHERE] = refuse
    kiss = optional("kiss_matcher") if rivals else None
    if kiss is not None:
        runs["kiss-matcher, scan to scan"] = lambda: kiss_pose(kiss[0], scene)
    count = len(scene.queries)
    result = row(name, threads, repeats, runs)
    correct = _correct(answers, scene, tolerance_m)
    if any(answer.localized for answer in refused):
        raise SeglocError("a query of another place was localized")
    others = dict(result.rivals)
    details = {}
    if scene.elsewhere:
        details["elsewhere, ms"] = others.pop(ELSEWHERE) / len(scene.elsewhere)
    clock = clock_for(threads)
    stages = [stage_ms(localizer, scan, clock) for scan, _ in scene.queries for _ in range(repeats)]
    details |= {
        "map segments": float(len(prior_map)),
        "query segments": statistics.median(a.counts["segments"] for a in answers),
        "queries": float(count),
        "correct": float(correct),
        "a second": 1e3 * count / result.ours_ms,
        **{f"{name}, ms": statistics.median(each[name] for each in stages) for name in stages[0]},
    }
    skipped = ("kiss-matcher",) if rivals and kiss is None else ()
    ours = result.ours_ms / count
    return Row(name, threads, ours, others, details=details, skipped=skipped)


def stage_ms(localizer: Localizer, query: Scan | LocalCloud, clock: Clock) -> dict[str, float]:
    """Milliseconds that each stage takes, by a clock of choice."""
    watch = StageTimes(clock)
    single_pass(localizer, query, watch)
    return watch.ms


def _correct(answers: Sequence[Localization], scene: Scene, tolerance_m: float) -> int:
    correct = 0
    for answer, (_, truth) in zip(answers, scene.queries, strict=True):
        if answer.T_map_sensor is None:
            continue
        error = float(np.linalg.norm(answer.T_map_sensor[:3, 3] - truth[:3, 3]))
        if error > tolerance_m:
            raise SeglocError(f"a query was localized {error:.1f} m off")
        correct += 1
    if not correct:
        raise SeglocError(f"no query was localized: {answers[0].reason}")
    return correct


def kiss_pose(kiss: Any, scene: Scene) -> Pose:
    """The first query relative to its mapped scan, by kiss-matcher."""
    matcher = kiss.KISSMatcher(kiss.KISSMatcherConfig(KISS_VOXEL_M))
    source, target = scene.queries[0][0].points, scene.mapped.points
    solution = matcher.estimate(list(source), list(target))
    return geometry.rigid(np.array(solution.rotation), np.array(solution.translation))


def simulated_scene(threads: int, method: str = DEFAULT_METHOD, queries: int = 5) -> Scene:
    """A street of a simulated town and a later drive along it; a plaza without the simulator."""
    config = Config.preset(method).model_copy(update={"threads": threads})
    if optional("embreex") is None:
        walk = harness.PlazaWalk(harness.Plaza())
        return _scene(build_map(walk, config), walk, walk, range(3, 3 + queries))
    from ..simulation import Route, hdl64e, simulate_session, town

    world = town(0, size_m=_TOWN_M)
    junctions = tuple(world.roads.walk(np.random.default_rng(0), [0], _STREET_M, avoid=[]))
    route = Route(junctions, length_m=_STREET_M)
    again = Route(junctions, lane_offset_m=0.3, length_m=_STREET_M)
    first = simulate_session(world, 0, route, hdl64e(900), 0)
    mapped = build_map(first, config)
    middle = first.scan(len(first) // 2)
    later = simulate_session(world, 1, again, hdl64e(900), 1)
    positions = np.linspace(0.2, 0.8, queries) * len(later)
    return _scene(mapped, later, middle, positions.astype(int).tolist())


def _scene(
    prior_map: SegmentMap, later: Recording, mapped: Recording | Scan, positions: Sequence[int]
) -> Scene:
    assert later.poses is not None
    scans: list[tuple[Scan | LocalCloud, Pose]] = [
        (_unposed(later.scan(i)), later.poses[i]) for i in positions
    ]
    return Scene(
        prior_map, scans, mapped if isinstance(mapped, Scan) else mapped.scan(positions[0])
    )


def _unposed(scan: Scan) -> Scan:
    return Scan(scan.points, stamp=scan.stamp)
