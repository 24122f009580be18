"""Time the stages of a query by a given clock."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

from segloc.frontend import Segmentation
from segloc.localizer import Localizer
from segloc.system.stage_times import Clock, StageTimes
from segloc.types import LocalCloud, Matches, Scan

_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_RESET_PEAK = "5"


def highest_mb() -> float:
    """The most that the process has held so far, megabytes."""
    return _status_kb("VmHWM") / 1024


def held_mb() -> float:
    """What the process holds now, megabytes."""
    return _status_kb("VmRSS") / 1024


def rise_mb(work: Callable[[], object]) -> float:
    """By how many megabytes the process's memory rises while it works, at its highest."""
    _RESET.write_text(_RESET_PEAK)
    before = held_mb()
    work()
    return highest_mb() - before


def _status_kb(field: str) -> int:
    for line in _STATUS.read_text().splitlines():
        if line.startswith(field + ":"):
            return int(line.split()[1])
    raise OSError(f"{_STATUS} has no {field}")


STAGES = (
    "segmentation",
    "preprocessing",
    "descriptor",
    "matching",
    "pruning",
    "pose",
    "verification",
)
"""Of a query whose local cloud is there."""


def processor_clock() -> float:
    """Seconds of processor time of this process; of the wall where that is too coarse."""
    return time.perf_counter() if sys.platform == "win32" else time.process_time()


def clock_for(threads: int) -> Clock:
    """The processor's time for one thread, which other work disturbs less; else the wall's."""
    return processor_clock if threads == 1 else time.perf_counter


def single_pass(
    localizer: Localizer, query: Scan | LocalCloud, watch: StageTimes
) -> tuple[Segmentation, Matches]:
    """Every stage of a query once, by segments alone; the scene and its matches."""
    cloud = query
    if isinstance(cloud, Scan):
        with watch("local cloud"):
            cloud = localizer.accumulator.gather(cloud)
    with watch("segmentation"):
        scene = localizer.segmenter.segment(cloud)
        segments = scene.segments
    with watch("preprocessing"):
        prepared = localizer.descriptor.prepare(segments)
    with watch("descriptor"):
        descriptors = localizer.descriptor.encode(prepared)
    with watch("matching"):
        candidates = localizer.matcher.match(descriptors)
    with watch("pruning"):
        matches = localizer.matcher.prune(descriptors, candidates)
    with watch("pose"):
        hypotheses = localizer.estimator.estimate(
            segments.centroids, localizer.prior_map.centroids, matches
        )
    with watch("verification"):
        likelihood, where = localizer.likelihood, localizer.prior_map.centroids
        agree = localizer.estimator.agreement(segments.centroids, where, matches)
        scorer = likelihood.scorer(likelihood.query(scene), agree)
        scorer.add(hypotheses)
        scorer.measure()
    return scene, matches
