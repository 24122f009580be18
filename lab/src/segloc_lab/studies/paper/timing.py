"""Time per query by stage and method (Table III of the paper)."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from segloc import SegmentMap
from segloc.config import Config
from segloc.descriptors import Descriptor, create
from segloc.frontend import Segmenter
from segloc.localizer import Localizer
from segloc.system.stage_times import Clock, StageTimes
from segloc.tools.batch import query_clouds
from segloc.tools.cli.machine import processor
from segloc.tools.datasets import Recording
from segloc.types import LocalCloud

from ...bench.harness import in_process
from ...evaluation.comparison import MappedPlace, build_maps, place_of, ready
from ...evaluation.study import Cell, Study, Table
from ...padding import padded_with_copies
from ...stages import STAGES, clock_for, single_pass
from . import published
from .localization import KittiScenario, SuiteScenario
from .workspace import Workspace

TEXT = """\
How long does one query take, and where does the time go? All methods are given the same clouds and
the same segments, in a map of the same size; they take turns, query by query, and each figure is a
median. Preprocessing brings segments into the form that a descriptor reads (alignment, sampling,
voxels); matching finds the nearest descriptors of the map, K for each segment; pruning lets a
random forest sort out matches; pose finds the poses that many matches agree on; verification, which
the paper has not, compares them with the map's own cloud."""

_PUBLISHED = "pose, published"
MAP_SEGMENTS = 10_000
_QUERIES = 5
_REPEATS = {"small": 3, "full": 9}

Times = dict[str, dict[str, float]]
Source = Callable[[], tuple[Recording, list[LocalCloud]]]


def run(workspace: Workspace) -> Study:
    """Time swathes of the test set "burgess" (the suite's last without one), and KITTI's scans."""
    start = time.perf_counter()
    descriptors = {name: create(name, 1) for name in ready(workspace.methods).names}
    tables = []
    for label, settings, source in _sources(workspace):
        measured = workspace.cached_json(
            f"timing-{label}",
            {
                "source": settings,
                "methods": {name: d.fingerprint for name, d in descriptors.items()},
                "machine": [processor(), os.cpu_count()],
                "repeats": _REPEATS[workspace.effort],
                "segments": MAP_SEGMENTS,
            },
            partial(_measured, source, descriptors, workspace),
        )
        tables.append(time_table(label, measured, descriptors))
    return Study(
        "timing",
        "Time of a query",
        (*tables, published.times()),
        (),
        workspace.facts(
            time.perf_counter() - start, {name: d.fingerprint for name, d in descriptors.items()}
        ),
        TEXT,
    )


def _sources(workspace: Workspace) -> Iterator[tuple[str, dict[str, Any], Source]]:
    test = next((t for t in workspace.sets if t.name == "burgess"), workspace.sets[-1])
    scenario = SuiteScenario(test, workspace.scale, workspace.seed)
    yield scenario.name, scenario.settings(), partial(_clouds, scenario)
    if workspace.data is not None:
        kitti = KittiScenario(workspace.data, True, workspace.scale, workspace.seed)
        yield kitti.name, kitti.settings(), partial(_clouds, kitti)


def _clouds(scenario: SuiteScenario | KittiScenario) -> tuple[Recording, list[LocalCloud]]:
    """Return the recording to map, and a few queries, evenly spread."""
    opened = scenario.open()
    query_set = next(iter(opened.query_sets.values()))
    count = min(_QUERIES, len(query_set.positions))
    chosen = query_set.positions[np.linspace(0, len(query_set.positions) - 1, count).astype(int)]
    clouds = query_clouds(query_set.recording, chosen, Config())
    return opened.map, [cloud for cloud, _ in clouds]


def _measured(
    source: Source, descriptors: Mapping[str, Descriptor], workspace: Workspace
) -> dict[str, Any]:
    recording, clouds = source()
    maps = build_maps(recording, descriptors)
    repeats, cores = _REPEATS[workspace.effort], os.cpu_count() or 1
    times: dict[str, Any] = {"one core": in_process(1, stage_times, maps, clouds, 1, repeats)}
    if cores > 1:
        times[f"{cores} cores"] = in_process(cores, stage_times, maps, clouds, cores, repeats)
    segmenter = Segmenter()
    scenes = [segmenter.segment(cloud) for cloud in clouds]
    return {
        "times": times,
        "segments": statistics.median(len(scene.segments) for scene in scenes),
        "map": len(next(iter(maps.values()))),
        "queries": len(clouds),
    }


def stage_times(
    maps: Mapping[str, SegmentMap], clouds: Sequence[LocalCloud], threads: int, repeats: int
) -> Times:
    """Return the median time of every stage by method [ms]; methods take turns.

    The maps are of the same segments; the first holds the cloud of all. With one thread the time is
    the processor's, which other work on the machine disturbs less.
    """
    clock = clock_for(threads)
    place = _padded_place(maps, threads)
    samples: dict[str, list[dict[str, float]]] = {name: [] for name in place.localizers}
    for repeat in range(repeats + 1):
        for cloud in clouds:
            for name, localizers in place.localizers.items():
                sample = _stage_ms(localizers, cloud, clock)
                if repeat:  # the first round warms up
                    samples[name].append(sample)
    medians = {
        name: {stage: statistics.median(each[stage] for each in found) for stage in found[0]}
        for name, found in samples.items()
    }
    shared = statistics.median(times["segmentation"] for times in medians.values())
    return {name: {**times, "segmentation": shared} for name, times in medians.items()}


def _padded_place(maps: Mapping[str, SegmentMap], threads: int) -> MappedPlace:
    """Return the place in maps of at least :data:`MAP_SEGMENTS`."""
    size = max(MAP_SEGMENTS, len(next(iter(maps.values()))))
    return place_of({name: padded_with_copies(each, size) for name, each in maps.items()}, threads)


def _stage_ms(
    localizers: Mapping[str, Localizer], cloud: LocalCloud, clock: Clock
) -> dict[str, float]:
    """Time every stage once with our estimator, and the pose with the paper's."""
    watch = StageTimes(clock)
    scene, matches = single_pass(localizers["consensus"], cloud, watch)
    published_ = localizers["published"]
    with watch(_PUBLISHED):
        centroids, mapped = scene.segments.centroids, published_.prior_map.centroids
        published_.estimator.estimate(centroids, mapped, matches)
    return watch.ms


def time_table(
    label: str, measured: Mapping[str, Any], descriptors: Mapping[str, Descriptor]
) -> Table:
    """Return one row per method and processor."""
    rows = [
        _row(name, processor, descriptors, times)
        for processor, by_method in measured["times"].items()
        for name, times in by_method.items()
    ]
    return Table(
        f"times-{label}",
        f"Milliseconds a query, {label}",
        (
            "method", "processor", "numbers", *STAGES[:4], "K", *STAGES[4:], "total",
            _PUBLISHED, "total, published",
        ),
        tuple(rows),
        f"Medians over {measured['queries']} clouds of {measured['segments']:g} segments; the map "
        f"has {max(measured['map'], MAP_SEGMENTS)} segments, {measured['map']} of this place, and "
        "the others of perturbed copies.",
    )  # fmt: skip


def _row(
    name: str, processor: str, descriptors: Mapping[str, Descriptor], times: Mapping[str, float]
) -> tuple[Cell, ...]:
    neighbours = Config.preset(name).matching.neighbours
    total = sum(times[stage] for stage in STAGES)
    slower = total - times["pose"] + times[_PUBLISHED]
    shown = [round(times[stage], 3) for stage in STAGES]
    ends = (round(total, 3), round(times[_PUBLISHED], 3), round(slower, 3))
    return (name, processor, descriptors[name].dim, *shown[:4], neighbours, *shown[4:], *ends)
