"""Time the work on the files that are named on stdin: a script for any version of segloc.

    python -m segloc_lab.bench.versions_worker {stages,query,build,align,stream} [MAP] < FILES

It imports nothing but ``segloc``, so that it runs with whatever version an interpreter has. Each
line of stdin is a file of points, or of recordings to build a map, to align sessions, or to drive
on in a map; each line of stdout has the processor time of its parts.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import sys
import time
from collections.abc import Callable
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

import segloc
from segloc.descriptors import create


def named(name: str, *modules: str) -> Any:
    """A class by its name, from the first of the modules that there is."""
    for module in modules:
        try:
            return getattr(importlib.import_module(f"segloc.{module}"), name)
        except ModuleNotFoundError:
            continue
    raise SystemExit(f"{segloc.__file__} has no {name}")


ACCUMULATOR = named("Accumulator", "frontend.local_cloud", "local_cloud")()
SEGMENTER = named("Segmenter", "frontend.segmentation", "segmentation")()
ATTITUDES = named("AttitudeEstimator", "frontend.gravity", "attitude")()
DESCRIPTOR = create("profile", threads=1)
CONFIG = segloc.Config.preset("profile").model_copy(update={"threads": 1})
QUERY_EVERY = 10


_KEPT_BYTES = 31 << 20
"""Once a block as large as a map's was freed, glibc keeps freed memory for the next scan."""

STAGES = (
    "gravity",
    "gathering, given gravity",
    "gathering",
    "segmentation",
    "preparation",
    "description",
)


@cache
def scan(path: str) -> tuple[segloc.Scan, segloc.Scan]:
    """A scan, and the same with a given gravity."""
    points = np.load(path)
    return segloc.Scan(points), segloc.Scan(points, gravity=[0.0, 0.0, -1.0])


def measure(path: str) -> dict[str, float]:
    """Milliseconds of processor time of each stage."""
    query, level = scan(path)
    marks = [time.process_time()]
    ATTITUDES.estimate(query.points)
    marks.append(time.process_time())
    ACCUMULATOR.gather(level)
    marks.append(time.process_time())
    cloud = ACCUMULATOR.gather(query)
    marks.append(time.process_time())
    scene = SEGMENTER.segment(cloud)
    marks.append(time.process_time())
    prepared = DESCRIPTOR.prepare(scene.segments)
    marks.append(time.process_time())
    DESCRIPTOR.encode(prepared)
    marks.append(time.process_time())
    ms = [1e3 * (b - a) for a, b in pairwise(marks)]
    return {**dict(zip(STAGES, ms, strict=True)), "all": sum(ms[2:])}


def in_map(path: Path) -> Callable[[str], dict[str, float]]:
    """What localizes a scan in a map, and times that."""
    clock = "clock" in inspect.signature(segloc.Localizer).parameters
    given: dict[str, Any] = {"clock": time.process_time} if clock else {}
    localizer = segloc.Localizer(segloc.SegmentMap.load(path), CONFIG, **given)

    def localize(name: str) -> dict[str, float]:
        query = scan(name)[0]
        start = time.process_time()
        answer = localizer.localize(query)
        ms = 1e3 * (time.process_time() - start)
        kind = "found" if answer.localized else "refused"
        return {kind: ms, **{f"{kind}, {stage}": t for stage, t in answer.times_ms.items()}}

    return localize


class Recorded:
    """One recording of a file; any version takes it."""

    def __init__(self, path: str, name: str) -> None:
        with np.load(path) as file:
            columns = (file[f"{name}/{key}"] for key in ("points", "offsets", "poses", "stamps"))
            self._points, self._offsets, self.poses, self.stamps = columns
        self.name, self.indices = name, np.arange(len(self.poses))

    def __len__(self) -> int:
        return len(self.poses)

    def scan(self, i: int) -> segloc.Scan:
        """The scan at position i, with its odometry."""
        points = self._points[self._offsets[i] : self._offsets[i + 1]]
        return segloc.Scan(points, stamp=float(self.stamps[i]), T_odom_sensor=self.poses[i])


@cache
def recordings(path: str) -> list[Recorded]:
    """The recordings of a file."""
    with np.load(path) as file:
        names = sorted({name.split("/")[0] for name in file.files})
    return [Recorded(path, name) for name in names]


def timed(stage: str, work: Callable[[], object], share: int = 1) -> dict[str, float]:
    """Milliseconds of processor time of some work, or of a share of it."""
    start = time.process_time()
    work()
    return {stage: 1e3 * (time.process_time() - start) / share}


def build(path: str) -> dict[str, float]:
    """Milliseconds a scan of a map's building."""
    (recording,) = recordings(path)
    work = partial(segloc.build_map, recording, CONFIG)
    return timed("building, a scan", work, len(recording))


def align(path: str) -> dict[str, float]:
    """Milliseconds a scan of an alignment of sessions."""
    sessions = recordings(path)
    work = partial(segloc.align_sessions, sessions, CONFIG)
    return timed("aligning, a scan", work, sum(map(len, sessions)))


def stream_in(path: Path) -> Callable[[str], dict[str, float]]:
    """What drives on in a map, with a query at every tenth scan, and times that."""
    localizer = segloc.Localizer(segloc.SegmentMap.load(path), CONFIG)

    def drive(recording: Recorded) -> None:
        config = localizer.config
        rolling = segloc.RollingCloud(
            config.local_cloud, config.segmentation.accumulated.voxel_size
        )
        for i in range(len(recording)):
            rolling.add(recording.scan(i))
            if i % QUERY_EVERY == QUERY_EVERY - 1:
                localizer.localize(rolling.cloud())

    def driven(name: str) -> dict[str, float]:
        (recording,) = recordings(name)
        return timed("stream, a scan", partial(drive, recording), len(recording))

    return driven


WORK: dict[str, Callable[[str], dict[str, float]]] = {
    "stages": measure,
    "build": build,
    "align": align,
}
IN_MAP = {"query": in_map, "stream": stream_in}


def main() -> None:
    shown = argparse.RawDescriptionHelpFormatter
    options = argparse.ArgumentParser(description=__doc__, formatter_class=shown)
    options.add_argument("work", choices=[*WORK, *IN_MAP])
    options.add_argument("map", type=Path, nargs="?")
    given = options.parse_args()
    work = WORK[given.work] if given.map is None else IN_MAP[given.work](given.map)
    np.ones(_KEPT_BYTES, np.uint8)
    for line in sys.stdin:
        found = work(line.strip())
        print(";".join(f"{stage}={ms:.6f}" for stage, ms in found.items()), flush=True)


if __name__ == "__main__":
    main()
