"""Time the front half of a query on scans that are named on stdin: a script for any version.

    python -m segloc_lab.bench.frontend_worker < FILES

It imports nothing but ``segloc``, so that it runs with whatever version an interpreter has. Each
line of stdin is a file of points; each line of stdout has the processor time of its stages.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from functools import cache
from itertools import pairwise
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


def main() -> None:
    shown = argparse.RawDescriptionHelpFormatter
    argparse.ArgumentParser(description=__doc__, formatter_class=shown).parse_args()
    for line in sys.stdin:
        found = measure(line.strip())
        print(";".join(f"{stage}={ms:.6f}" for stage, ms in found.items()), flush=True)


if __name__ == "__main__":
    main()
