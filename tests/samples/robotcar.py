"""Traversals in the layout of the Oxford RobotCar dataset, as its documentation describes it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from segloc_lab.simulation import Lidar, LineLidar, SimulatedSequence

from samples.datasets import FLIP, START, angles, made, matrix, us
from segloc import geometry
from segloc.types import Float64

# x, y, z in metres and roll, pitch, yaw, from the extrinsics of the dataset's SDK.
FRONT = matrix((1.7589, 0.2268, 1.0411), (-0.0437, -1.4572, 0.0356))
INS = matrix((-1.7132, 0.1181, 1.1948), (-0.0125, 0.0400, 0.0050))


def write_sweep(folder: Path, stamp: float, flat: Float64) -> None:
    """Points (N, 2) in the scanner's plane; firings without return are zeros."""
    rows = np.vstack([np.column_stack([flat, np.full(len(flat), 500.0)]), np.zeros((3, 3))])
    (made(folder) / f"{us(stamp)}.bin").write_bytes(rows.astype("<f8").tobytes())


def write_ins(path: Path, stamps: Float64, T_world_car: Float64, *, status: bool = True) -> None:
    """Poses of the car in north, east, down, (N, 4, 4), as the INS that is mounted on it."""
    names = "latitude,longitude,altitude,northing,easting,down,utm_zone,velocity_north"
    text = f"timestamp,{'ins_status,' * status}{names},roll,pitch,yaw\n"
    for stamp, pose in zip(stamps, T_world_car, strict=True):
        T = pose @ INS
        good = "INS_SOLUTION_GOOD," * status
        xyz = ",".join(f"{v:.16g}" for v in T[:3, 3])
        rpy = ",".join(f"{v:.12g}" for v in angles(T))
        text += f"{us(stamp)},{good}51.7,-1.2,110.0,{xyz},30U,0.0,{rpy}\n"
    made(path.parent)
    path.write_text(text)


def T_sensor_car(sensor: Lidar) -> Float64:
    """From the car as it is read, z up, to the simulated sensor that stands for its front one."""
    assert isinstance(sensor, LineLidar)
    plane = np.eye(4)
    roll, pitch, yaw = sensor.plane_rpy_deg
    plane[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()
    return plane @ FLIP @ geometry.inverse(FLIP @ FRONT)


def write_drive(folder: Path, drive: SimulatedSequence, *, rate_hz: float = 20.0) -> Path:
    """A drive of a simulated push-broom sensor, with its odometry for the INS's poses."""
    mount = T_sensor_car(drive.sensor)
    T_plane_sensor = geometry.inverse(FRONT) @ FLIP @ geometry.inverse(mount)
    stamps = START + 0.013 + np.arange(len(drive)) / rate_hz
    for i, stamp in enumerate(stamps):
        points = geometry.transform(T_plane_sensor, drive.scan(i).points)
        assert np.abs(points[:, 2]).max(initial=0.0) < 1e-3
        write_sweep(folder / "lms_front", stamp, points[:, :2])
    listed = "\n".join(f"{us(stamp)} 1" for stamp in stamps)
    (folder / "lms_front.timestamps").write_text(listed + "\n")
    write_ins(folder / "gps" / "ins.csv", stamps, FLIP @ drive.poses @ mount @ FLIP)
    return folder
