"""A walk across a plaza, in memory and as a folder of scans; and the command line, run here."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from segloc import geometry
from segloc.tools import cli
from segloc.tools.io import Trajectory, write_scan, write_tum
from segloc.types import Float64, Recording, Scan

from .plaza import Plaza, PlazaSequence

Points = Callable[[Float64], Float64]
Poses = Callable[[Float64], Float64]

FEW, ALL = 40_000, 200_000
"""Points of a scan, at most: what looks at them takes as long as they are many."""


class Walk(PlazaSequence):
    """A plaza crossed in curves; perhaps with points that are written wrongly."""

    def __init__(
        self, written: Points = lambda points: points, posed: bool = True, most: int = FEW
    ) -> None:
        super().__init__(Plaza(1, objects=90), steps=14, posed=posed)
        turns = 0.5 * np.sin(0.6 * np.arange(len(self)))
        for T, yaw in zip(self.poses, turns, strict=True):
            T[:3, :3] = geometry.yaw_transform(float(yaw))[:3, :3]
        self._written, self._most = written, most

    def scan(self, i: int) -> Scan:
        seen = super().scan(i)
        points = seen.points
        if len(points) > self._most:
            points = points[np.random.default_rng(i).permutation(len(points))[: self._most]]
        written = self._written(points.astype(np.float64))
        return Scan(written, T_odom_sensor=seen.T_odom_sensor)


def in_view(points: Float64) -> Float64:
    """What a sensor that sees 120 degrees has of a scan."""
    return points[np.abs(np.arctan2(points[:, 1], points[:, 0])) < np.radians(60)]


def written(
    folder: Path,
    points: Points = lambda p: p,
    poses: Poses = lambda T: T,
    most: int = FEW,
) -> Path:
    """A walk as a folder of scans."""
    walk = Walk(points, most=most)
    as_folder(folder, walk)
    write_tum(folder / "poses.tum", Trajectory(np.arange(len(walk)), poses(walk.poses)))
    return folder


def as_folder(folder: Path, recording: Recording, poses: str = "poses.tum") -> Path:
    """A recording as a folder of scans and a file of its poses."""
    folder.mkdir()
    for i in range(len(recording)):
        write_scan(folder / f"{i:04d}.npy", recording.scan(i).points)
    assert recording.poses is not None
    write_tum(folder / poses, Trajectory(np.arange(len(recording)), recording.poses))
    return folder


def run(*arguments: object) -> int:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["segloc", *map(str, arguments)])
        try:
            cli.main()
        except SystemExit as stop:
            return int(stop.code or 0)
    return 0


POINTS_ASIDE = Plaza(77, objects=12).scan(geometry.yaw_transform(0.3, (5.0, 9.0, 1.8))).points
"""What is seen at another plaza."""


class Site(NamedTuple):
    """A recording and a map of it."""

    run: Path
    map: Path
