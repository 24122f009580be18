"""Simulate the sample of ``segloc demo`` and ``segloc sample``, and store it beside its reader.

    python -m segloc_lab.record_sample        # writes src/segloc/sample/*.npz

Monday and Tuesday are sessions of one town, a car's drives with different sensors; on Tuesday other
cars are parked, half of the leaves are gone, and 15 % of what can be replaced is replaced. Tuesday
goes along Monday's way in another lane, leaves it, and returns in the opposite direction.
The third drive is in another town. Seed 0 throughout. Processors round rays differently: another
machine may record slightly different files. Takes about a minute.
"""

from __future__ import annotations

import zipfile
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from segloc import sample
from segloc.types import Float32, Float64

from .script import parser
from .simulation import (
    Conditions,
    Route,
    SimulatedSequence,
    SpinningLidar,
    car,
    hdl32e,
    os1_64,
    simulate_session,
    town,
)
from .simulation.sensors.ranging import Rays

SEED, ELSEWHERE_SEED = 0, 1000
SIZE_M = 180.0
MONDAY = Route((3, 0, 1, 2, 5), lane_offset_m=1.1, spacing_m=2.5)
TUESDAY = Route((5, 2, 1, 0, 3, 4, 5, 2), lane_offset_m=0.7, spacing_m=4.5)
ELSEWHERE = Route((3, 0, 1, 2, 5), lane_offset_m=1.1, spacing_m=4.5, length_m=110.0)
AUTUMN = Conditions(foliage=0.5, replaced=0.15)
_EPOCH = (2024, 1, 1, 0, 0, 0)  # of the archive's entries: files depend on the drives alone


class Locked(SpinningLidar):
    """A spinning LiDAR that fires at the same azimuths in every scan."""

    def rays(self, phase: float, number: int = 0) -> Rays:
        return super().rays(0.0, number)


def locked(sensor: SpinningLidar) -> Locked:
    return Locked(**{each.name: getattr(sensor, each.name) for each in fields(sensor)})


def drives() -> dict[sample.Name, SimulatedSequence]:
    """The three drives; Monday's poses are the truth, the others are odometry."""
    here, there = town(SEED, size_m=SIZE_M), town(ELSEWHERE_SEED, size_m=SIZE_M)
    driven = partial(simulate_session, seed=SEED, platform=car())
    mapping, querying = locked(hdl32e(700)), locked(os1_64(512))
    return {
        "monday": driven(here, 0, MONDAY, mapping),
        "tuesday": driven(here, 1, TUESDAY, querying, conditions=AUTUMN).with_odometry(),
        "elsewhere": driven(there, 0, ELSEWHERE, querying).with_odometry(),
    }


def range_image(points: Float32, sensor: SpinningLidar) -> NDArray[np.uint16]:
    """Sort the points of a scan by beam and firing: ranges (B, F), 0 where nothing returned."""
    elevations = np.radians(np.array(sensor.elevations_deg))
    offsets = np.radians(np.array(sensor.azimuths_deg))
    xyz = points.astype(np.float64)
    metres = np.linalg.norm(xyz, axis=1)
    beam = np.abs(np.arcsin(xyz[:, 2] / metres)[:, None] - elevations).argmin(axis=1)
    turn = offsets[beam % len(offsets)] - np.arctan2(xyz[:, 1], xyz[:, 0])
    firing = np.rint(turn / (2 * np.pi) * sensor.azimuth_steps).astype(int) % sensor.azimuth_steps
    image = np.zeros((len(elevations), sensor.azimuth_steps), dtype=np.uint16)
    image[beam, firing] = np.rint(metres / sample.RANGE_UNIT_M)
    if np.count_nonzero(image) != len(points):
        raise RuntimeError("two points fell on one ray")
    return image


def unit_circle(angles: Float64) -> Float64:
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def stored(drive: SimulatedSequence) -> dict[str, np.ndarray]:
    """The arrays of a drive's file."""
    sensor = drive.sensor
    assert isinstance(sensor, SpinningLidar) and drive.stamps is not None
    images = [range_image(drive.scan(i).points, sensor) for i in range(len(drive))]
    ranges = np.stack(images).reshape(-1)
    returned = ranges[ranges > 0].astype(np.int32)
    steps: NDArray[np.int32] = np.diff(returned, prepend=np.int32(0))
    zigzag = ((steps << 1) ^ (steps >> 31)).astype(np.uint16)
    turn = -2 * np.pi * np.arange(sensor.azimuth_steps) / sensor.azimuth_steps
    return {
        "stamps": drive.stamps,
        "poses": drive.poses,
        "truth": drive.truth,
        "elevations": unit_circle(np.radians(np.array(sensor.elevations_deg))),
        "azimuths": unit_circle(turn + np.radians(np.array(sensor.azimuths_deg))[:, None]),
        "returned": np.packbits(ranges > 0),
        "low": (zigzag & 0xFF).astype(np.uint8),
        "high": (zigzag >> 8).astype(np.uint8),
    }


def write(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write a compressed ``.npz`` archive."""
    with zipfile.ZipFile(path, "w", compresslevel=9) as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(entry, "w") as file:
                np.lib.format.write_array(file, np.ascontiguousarray(array), allow_pickle=False)


def main() -> None:
    command = parser(__doc__)
    command.add_argument("--out", type=Path, default=sample.FOLDER)
    options = command.parse_args()
    for name, drive in drives().items():
        path = options.out / f"{name}.npz"
        write(path, stored(drive))
        print(f"{path}: {len(drive)} scans, {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
