"""Time queries of the scans that are named on stdin: a script for any version of segloc.

    python -m segloc_lab.bench.versions_worker [MAP] < FILES

It imports nothing but ``segloc``, so that it runs with whatever version an interpreter has. Each
line of stdin is a file of points; each line of stdout has the processor time of its stages up to
the descriptors or, in a map, of the whole query by how it ended.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from collections.abc import Callable
from functools import cache
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
    config = segloc.Config.preset("profile").model_copy(update={"threads": 1})
    localizer = segloc.Localizer(segloc.SegmentMap.load(path), config)

    def localize(name: str) -> dict[str, float]:
        query = scan(name)[0]
        start = time.process_time()
        answer = localizer.localize(query)
        ms = 1e3 * (time.process_time() - start)
        return {"found" if answer.localized else "refused": ms}

    return localize


def main() -> None:
    shown = argparse.RawDescriptionHelpFormatter
    options = argparse.ArgumentParser(description=__doc__, formatter_class=shown)
    options.add_argument("map", type=Path, nargs="?")
    prior_map = options.parse_args().map
    timed = measure if prior_map is None else in_map(prior_map)
    np.ones(_KEPT_BYTES, np.uint8)
    for line in sys.stdin:
        found = timed(line.strip())
        print(";".join(f"{stage}={ms:.6f}" for stage, ms in found.items()), flush=True)


if __name__ == "__main__":
    main()
