"""Run by ``make wheel-check`` in an environment that holds the wheel and nothing else."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from samples.plaza import Plaza, PlazaSequence

import segloc
from segloc import Config, Localizer, SegmentMap, build_map, geometry
from segloc.io import read_scan, write_scan

METHODS = ("profile", "geo", "dsm", "dsm-fq", "segmatch-esf", "nsm")
HEAVY = ("torch", "matplotlib", "trimesh", "embreex", "rosbags", "rclpy", "viser", "open3d")


def check(method: str, plaza: Plaza, folder: Path) -> None:
    """A scan of a small plaza is found in a map of it; both come from files."""
    build_map(PlazaSequence(plaza, steps=5), Config.preset(method)).save(
        folder / f"{method}.segmap"
    )
    T = geometry.yaw_transform(1.0, (-7.0, -2.0, 1.7))
    scan = plaza.scan(T, posed=False, seed=77)
    write_scan(folder / "query.pcd", scan.points)
    query = read_scan(folder / "query.pcd")
    assert np.array_equal(query.points, scan.points)
    result = Localizer(SegmentMap.load(folder / f"{method}.segmap")).localize(query)
    assert result.localized and result.T_map_sensor is not None, f"{method}: {result.reason}"
    assert np.abs(result.T_map_sensor - T).max() < 0.1, method


square = Plaza(0)
with tempfile.TemporaryDirectory() as name:
    for method in METHODS:
        check(method, square, Path(name))
for heavy in HEAVY:
    assert heavy not in sys.modules, heavy
print(f"segloc {segloc.__version__}: {', '.join(METHODS)}")
