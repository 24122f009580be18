"""Time the work on the files that are named on stdin: a script for any version of segloc.

    python -m segloc_lab.bench.worker {stages,query,build,align,stream} [--map MAP] < FILES

It imports nothing but ``segloc``, so that it runs with whatever version an interpreter has. Each
line of stdin is a file of recordings: scans to process or to localize in a map, or drives to build
a map of, to align, or to follow in a map. Each line of stdout has the version, the time of the
parts, of the processor for one thread and of the wall for several, and counts of the answers.
"""

from __future__ import annotations

import argparse
import atexit
import importlib
import inspect
import json
import math
import shutil
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

import segloc
from segloc.descriptors import create

QUERY_EVERY = 10
TOLERANCE_M, TOLERANCE_DEG = 3.0, 5.0

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


def named(name: str, *modules: str) -> Any:
    """Return a class by its name, from the first of the modules that exists."""
    for module in modules:
        try:
            return getattr(importlib.import_module(f"segloc.{module}"), name)
        except ModuleNotFoundError:
            continue
    raise SystemExit(f"{segloc.__file__} has no {name}")


class Recorded:
    """One recording of a file; any version takes it."""

    def __init__(self, path: str, name: str) -> None:
        with np.load(path) as file:
            found = {key: file[f"{name}/{key}"] for key in ("points", "offsets", "stamps")}
            self.poses = file[f"{name}/poses"] if f"{name}/poses" in file.files else None
        self._points, self._offsets, self.stamps = found.values()
        self.name, self.indices = name, np.arange(len(self.stamps))

    def __len__(self) -> int:
        return len(self.indices)

    def scan(self, i: int, **given: Any) -> segloc.Scan:
        """Return the scan at position i, with its odometry."""
        points = self._points[self._offsets[i] : self._offsets[i + 1]]
        if self.poses is not None:
            given["T_odom_sensor"] = self.poses[i]
        return segloc.Scan(points, stamp=float(self.stamps[i]), **given)


class Inputs:
    """The recordings of a file, and the true poses of its queries."""

    def __init__(self, path: str) -> None:
        with np.load(path) as file:
            self.truths = file["truths"] if "truths" in file.files else None
            near = file["near"].tolist() if "near" in file.files else None
            self.near = None if near is None else (near[:2], near[2])
            names = sorted({name.split("/")[0] for name in file.files if "/" in name})
        self.recordings = [Recorded(path, name) for name in names]
        self.scans = [self.recordings[0].scan(i) for i in range(len(self.recordings[0]))]


Timed = tuple[dict[str, float], dict[str, int]]
"""Milliseconds by stage, and counts of answers."""


class Work:
    """All kinds of work, with a number of threads and in a map."""

    def __init__(self, threads: int, prior_map: Path | None, tile_m: float | None) -> None:
        self.clock = time.process_time if threads == 1 else time.perf_counter
        self.config = segloc.Config.preset("profile").model_copy(update={"threads": threads})
        self.segmenter = named("Segmenter", "frontend.segmentation", "segmentation")()
        self.accumulator = named("Accumulator", "frontend.local_cloud", "local_cloud")()
        self.attitudes = named("AttitudeEstimator", "frontend.gravity", "attitude")()
        self.descriptor = create("profile", threads=threads)
        if prior_map is not None:
            takes_clock = "clock" in inspect.signature(segloc.Localizer).parameters
            given: dict[str, Any] = {"clock": self.clock} if takes_clock else {}
            where, make = segloc.SegmentMap.load(prior_map), segloc.Localizer
            if tile_m is not None:
                where, make = in_tiles(where, tile_m)
            self.localizer = make(where, self.config, **given)

    def timed(self, work: Callable[[], Any]) -> tuple[Any, float]:
        """Return what some work returns, and its milliseconds."""
        start = self.clock()
        found = work()
        return found, 1e3 * (self.clock() - start)

    def stages(self, inputs: Inputs) -> Timed:
        """Take a scan up to its descriptors."""
        (query,) = inputs.scans
        level = inputs.recordings[0].scan(0, gravity=[0.0, 0.0, -1.0])
        marks = [self.clock()]
        self.attitudes.estimate(query.points)
        marks.append(self.clock())
        self.accumulator.gather(level)
        marks.append(self.clock())
        cloud = self.accumulator.gather(query)
        marks.append(self.clock())
        segments = self.segmenter.segment(cloud).segments
        marks.append(self.clock())
        prepared = self.descriptor.prepare(segments)
        marks.append(self.clock())
        self.descriptor.encode(prepared)
        marks.append(self.clock())
        ms = [1e3 * (b - a) for a, b in pairwise(marks)]
        return {**dict(zip(STAGES, ms, strict=True)), "all": sum(ms[2:])}, {}

    def query(self, inputs: Inputs) -> Timed:
        """Localize the last of one or more scans."""
        scans = inputs.scans if len(inputs.scans) > 1 else inputs.scans[0]
        answer, ms = self.timed(lambda: self.localizer.localize(scans, near=inputs.near))
        kind = kind_of(answer, None if inputs.truths is None else inputs.truths[-1])
        stages = {f"{kind}, {s}": t for s, t in answer.times_ms.items() if s != "total"}
        return {kind: ms, **stages}, {kind: 1}

    def build(self, inputs: Inputs) -> Timed:
        """Build a map."""
        (recording,) = inputs.recordings
        _, ms = self.timed(lambda: segloc.build_map(recording, self.config))
        return {"a scan": ms / len(recording)}, {}

    def align(self, inputs: Inputs) -> Timed:
        """Bring sessions into one frame."""
        sessions = inputs.recordings
        _, ms = self.timed(lambda: segloc.align_sessions(sessions, self.config))
        return {"a scan": ms / sum(map(len, sessions))}, {}

    def stream(self, inputs: Inputs) -> Timed:
        """Follow a drive with a query at every tenth scan; its first half fills the window."""
        config = self.localizer.config
        rolling = segloc.RollingCloud(
            config.local_cloud, config.segmentation.accumulated.voxel_size
        )
        scans, start = inputs.scans, len(inputs.scans) // 2
        for scan in scans[:start]:
            rolling.add(scan)
        spent: defaultdict[str, float] = defaultdict(float)
        kinds: Counter[str] = Counter()
        for i in range(start, len(scans)):
            spent["adding, a scan"] += self.timed(partial(rolling.add, scans[i]))[1]
            if (i - start) % QUERY_EVERY == QUERY_EVERY - 1:
                cloud, ms = self.timed(rolling.cloud)
                spent["cloud, a query"] += ms
                answer, ms = self.timed(partial(self.localizer.localize, cloud))
                spent["localizing, a query"] += ms
                kinds[kind_of(answer, None if inputs.truths is None else inputs.truths[i])] += 1
        count, queries = len(scans) - start, sum(kinds.values())
        parts = {k: ms / (count if k.endswith("scan") else queries) for k, ms in spent.items()}
        return {"a scan": sum(spent.values()) / count, **parts}, dict(kinds)


def in_tiles(prior_map: Any, tile_m: float) -> tuple[Any, Any]:
    """Return a map in tiles, in a folder until the process ends, and the class that takes it."""
    tiles = importlib.import_module("segloc.tiles")
    folder = tempfile.mkdtemp()
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    tiles.cut_tiles(prior_map, folder, size_m=tile_m)
    return tiles.TiledMap(folder), getattr(tiles, "TiledLocalizer", segloc.Localizer)


def kind_of(answer: Any, truth: Any) -> str:
    """Return whether an answer is found, refused, or false."""
    if not answer.localized:
        return "refused"
    if truth is None:
        return "false"
    off = np.linalg.inv(truth) @ answer.T_map_sensor
    turned = math.degrees(math.acos(np.clip((np.trace(off[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)))
    is_right = float(np.linalg.norm(off[:3, 3])) <= TOLERANCE_M and turned <= TOLERANCE_DEG
    return "found" if is_right else "false"


KINDS = ("stages", "query", "build", "align", "stream")


def main() -> None:
    shown = argparse.RawDescriptionHelpFormatter
    options = argparse.ArgumentParser(description=__doc__, formatter_class=shown)
    options.add_argument("work", choices=KINDS)
    options.add_argument("--map", type=Path)
    options.add_argument("--tiles", type=float, help="edge of tiles that the map is cut into")
    options.add_argument("--threads", type=int, default=1)
    given = options.parse_args()
    work = getattr(Work(given.threads, given.map, given.tiles), given.work)
    read = cache(Inputs)
    np.ones(_KEPT_BYTES, np.uint8)
    for line in sys.stdin:
        ms, counts = work(read(line.strip()))
        found = {"version": segloc.__version__, "ms": ms, "counts": counts}
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
