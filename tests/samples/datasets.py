"""Small recordings in the formats of datasets, written byte for byte as their documents say."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from samples.io import pcd
from segloc import geometry
from segloc.tools.io import write_scan
from segloc.types import Float64

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
START = 1_600_000_000.0  # seconds since 1970


@dataclass(frozen=True)
class Drive:
    """A sensor on a slow curve past fixed points: what every sample is a recording of."""

    stamps: Float64
    landmarks: Float64

    @staticmethod
    def make(count: int = 5, points: int = 300, seed: int = 0) -> Drive:
        rng = np.random.default_rng(seed)
        box = [[-30, -30, -2], [30, 30, 6]]
        return Drive(START + 0.1 * np.arange(count), rng.uniform(*box, (points, 3)))

    def pose(self, time: float) -> Float64:
        """T_world_sensor, z up, slightly tilted."""
        t = time - START
        T = geometry.yaw_transform(0.3 + 0.2 * t, (4.0 * t, 1.0 * t, 0.1 * t))
        T[:3, :3] = T[:3, :3] @ Rotation.from_euler("yx", [0.03, -0.02]).as_matrix()
        return T

    @property
    def poses(self) -> Float64:
        return np.array([self.pose(t) for t in self.stamps])

    def seen(self, i: int) -> Float64:
        """The landmarks in the sensor's frame."""
        return geometry.transform(geometry.inverse(self.pose(self.stamps[i])), self.landmarks)

    def swept(self, times: Float64) -> Float64:
        """The landmarks, each seen from where the sensor was at its own time."""
        poses = [geometry.inverse(self.pose(time)) for time in times]
        pairs = zip(poses, self.landmarks, strict=True)
        return np.array([geometry.transform(T, point[None])[0] for T, point in pairs])


def bag_writer(kind: str) -> Any:
    """Return a ``BagWriter``; skip the test where rosbags is missing."""
    pytest.importorskip("rosbags")
    from samples.bags import BagWriter

    return BagWriter(kind)


def matrix(xyz: tuple[float, ...], rpy: tuple[float, ...]) -> Float64:
    """Rz(yaw) Ry(pitch) Rx(roll), written out."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    T = np.eye(4)
    T[:3, :3] = (
        np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
        @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    )
    T[:3, 3] = xyz
    return T


def angles(T: Float64) -> tuple[float, float, float]:
    """Roll, pitch, yaw of ``matrix``."""
    R = T[:3, :3]
    roll, pitch = np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(R[2, 0])
    return float(roll), float(pitch), float(np.arctan2(R[1, 0], R[0, 0]))


def us(stamp: float) -> int:
    return round(stamp * 1e6)


def ns(stamp: float) -> int:
    return round(stamp * 1e6) * 1000


def made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def numbered(folder: Path, names: list[str]) -> Path:
    """A folder of scans; the scan at position i has the point (i, 0, 0) i + 1 times."""
    for i, name in enumerate(names):
        write_scan(made(folder) / name, np.tile([float(i), 0, 0], (i + 1, 1)))
    return made(folder)


def write_pcap(
    path: Path, frames: list[tuple[float, bytes]], order: str = "<", unit: int = 10**6
) -> Path:
    """A capture of frames by their stamps, in libpcap's format."""
    magic = 0xA1B2C3D4 if unit == 10**6 else 0xA1B23C4D
    content = struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 65535, 1)
    for stamp, frame in frames:
        seconds, rest = divmod(round(stamp * unit), unit)
        content += struct.pack(f"{order}IIII", seconds, rest, len(frame), len(frame)) + frame
    path.write_bytes(content)
    return path


def float_rows(points: Float64, *columns: Float64) -> bytes:
    return np.column_stack([points, *columns]).astype("<f4").tobytes()


def ones(points: Float64) -> Float64:
    return np.ones(len(points))


def kitti(root: Path, drive: Drive) -> Path:
    """sequences/00 with camera poses in poses/00.txt."""
    folder = made(root / "sequences" / "00")
    T_cam_velo = matrix((-0.01, -0.06, -0.29), (-1.57, 1.56, 0.02))
    row = " ".join(f"{v:.9e}" for v in T_cam_velo[:3].ravel())
    (folder / "calib.txt").write_text(f"P0: {row}\nTr: {row}\n")
    (folder / "times.txt").write_text("".join(f"{t - START:.6e}\n" for t in drive.stamps))
    first = drive.poses[0]
    lines = []
    for i, T in enumerate(drive.poses):
        path = made(folder / "velodyne") / f"{i:06d}.bin"
        points = drive.seen(i)
        path.write_bytes(float_rows(points, ones(points)))
        camera = T_cam_velo @ geometry.inverse(first) @ T @ geometry.inverse(T_cam_velo)
        lines.append(" ".join(f"{v:.9e}" for v in camera[:3].ravel()))
    (made(root / "poses") / "00.txt").write_text("\n".join(lines) + "\n")
    return folder


def kitti_raw(root: Path, drive: Drive) -> Path:
    """2011_10_03_drive_0027_sync with OXTS packets and calibration."""
    day = made(root / "2011_10_03")
    folder = made(day / "2011_10_03_drive_0027_sync")
    T_velo_imu = matrix((-0.81, 0.32, -0.80), (0.01, -0.02, 0.015))
    R, t = T_velo_imu[:3, :3].ravel(), T_velo_imu[:3, 3]
    text = "calib_time: 25-May-2012 16:47:16\n"
    for key, values in (("R", R), ("T", t)):
        text += f"{key}: " + " ".join(f"{v:.9e}" for v in values) + "\n"
    (day / "calib_imu_to_velo.txt").write_text(text)
    base, radius = 49.0, 6378137.0
    scale = np.cos(np.radians(base))
    y0 = scale * radius * np.log(np.tan(np.pi / 4 + np.radians(base) / 2))
    clocks = []
    origin = (drive.poses[0] @ T_velo_imu)[:3, 3]
    for i, T in enumerate(drive.poses):
        T_world_imu = T @ T_velo_imu
        x, y, z = T_world_imu[:3, 3] - origin
        latitude = 2 * np.degrees(np.arctan(np.exp((y + y0) / (scale * radius)))) - 90
        packet = [latitude, np.degrees(x / (scale * radius)), z, *angles(T_world_imu)]
        line = " ".join(f"{v:.15g}" for v in [*packet, *[0.0] * 24])
        (made(folder / "oxts" / "data") / f"{i:010d}.txt").write_text(line + "\n")
        points = drive.seen(i)
        scan = made(folder / "velodyne_points" / "data") / f"{i:010d}.bin"
        scan.write_bytes(float_rows(points, ones(points)))
        clocks.append(str(np.datetime64(ns(drive.stamps[i]), "ns")).replace("T", " "))
    for part in ("oxts", "velodyne_points"):
        (folder / part / "timestamps.txt").write_text("\n".join(clocks) + "\n")
    return folder


def binary_pcd(points: Float64) -> bytes:
    """A PCD file of x, y, z and intensity."""
    rows = np.column_stack([points, ones(points)]).astype("<f4")
    return pcd(np.rec.fromarrays(rows.T, names="x,y,z,intensity"), "binary")


def wild_places(root: Path, drive: Drive) -> Path:
    """Clouds/SECONDS.pcd with as many digits as Python prints, poses_aligned.csv beside them."""
    folder = made(root / "V-03")
    rows = ["timestamp,x,y,z,qx,qy,qz,qw"]
    for i, T in enumerate(drive.poses):
        stamp = repr(float(drive.stamps[i]))
        (made(folder / "Clouds") / f"{stamp}.pcd").write_bytes(binary_pcd(drive.seen(i)))
        values = [*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat()]
        rows.append(f"{stamp}," + ",".join(f"{v:.12g}" for v in values))
    (folder / "poses_aligned.csv").write_text("\n".join(rows) + "\n")
    return folder


def newer_college(root: Path, drive: Drive) -> Path:
    """raw_format/ouster_scan as binary PCD, registered_poses.csv."""
    folder = made(root / "01_short_experiment")
    q = Rotation.from_quat([0, 0, 0.924, 0.383]).as_matrix()
    T_base_lidar = geometry.rigid(q, np.array([-0.084, -0.025, 0.05]))
    rows = ["#sec,nsec,x,y,z,qx,qy,qz,qw"]
    for i, T in enumerate(drive.poses):
        seconds, rest = divmod(ns(drive.stamps[i]), 10**9)
        scan = made(folder / "raw_format" / "ouster_scan") / f"cloud_{seconds}_{rest:09d}.pcd"
        scan.write_bytes(binary_pcd(drive.seen(i)))
        base = T @ geometry.inverse(T_base_lidar)
        values = [*base[:3, 3], *Rotation.from_matrix(base[:3, :3]).as_quat()]
        rows.append(f"{seconds},{rest}," + ",".join(f"{v:.12g}" for v in values))
    (made(folder / "ground_truth") / "registered_poses.csv").write_text("\n".join(rows))
    return folder


def mulran(root: Path, drive: Drive) -> Path:
    """Ouster/*.bin and base poses at 100 Hz in UTM."""
    folder = made(root / "DCC01")
    mount = matrix((1.7042, -0.021, 1.8047), tuple(np.radians([0.0001, 0.0003, 179.6654])))
    for i, stamp in enumerate(drive.stamps):
        points = drive.seen(i)
        scan = made(folder / "Ouster") / f"{ns(stamp)}.bin"
        scan.write_bytes(float_rows(points, ones(points)))
    rows = []
    for time in np.arange(START - 0.105, drive.stamps[-1] + 0.1, 0.01):
        base = drive.pose(time) @ geometry.inverse(mount)
        base[:3, 3] += [354_000.0, 4_026_000.0, 20.0]
        rows.append(f"{ns(time)}," + ",".join(f"{v:.16g}" for v in base[:3].ravel()))
    (folder / "global_pose.csv").write_text("\n".join(rows) + "\n")
    return folder


def nclt(root: Path, drive: Drive) -> Path:
    """velodyne_sync in steps of 5 mm, z down, and the ground truth beside it."""
    folder = made(root / "2012-01-08")
    rows = []
    for i, T in enumerate(drive.poses):
        points = geometry.transform(FLIP, drive.seen(i))
        steps = np.round((points + 100.0) / 0.005).astype(int)
        data = b"".join(struct.pack("<HHHBB", *step, 20, 3) for step in steps)
        (made(folder / "velodyne_sync") / f"{us(drive.stamps[i])}.bin").write_bytes(data)
        down = FLIP @ T @ FLIP
        values = ",".join(f"{v:.12g}" for v in [*down[:3, 3], *angles(down)])
        rows.append(f"{us(drive.stamps[i])},{values}")
    first = f"{us(START) - 10_000},NaN,NaN,NaN,NaN,NaN,NaN\n"
    (folder / "groundtruth_2012-01-08.csv").write_text(first + "\n".join(rows) + "\n")
    return folder


def boreas(root: Path, drive: Drive) -> Path:
    """lidar/*.bin with seconds from the middle of the turn, applanix/lidar_poses.csv."""
    folder = made(root / "boreas-2021-08-05-13-34")
    rows = ["GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,w,w,w"]
    for i, T in enumerate(drive.poses):
        points = drive.seen(i)
        scan = made(folder / "lidar") / f"{us(drive.stamps[i])}.bin"
        scan.write_bytes(float_rows(points, ones(points), ones(points), 0 * ones(points)))
        back = T.copy()
        back[:3, :3] = T[:3, :3].T  # C_enu_sensor = Rx(-r) Ry(-p) Rz(-y) = (Rz Ry Rx)^T
        values = [*T[:3, 3], 0, 0, 0, *angles(back), 0, 0, 0]
        rows.append(f"{us(drive.stamps[i])}," + ",".join(f"{v:.12g}" for v in values))
    (made(folder / "applanix") / "lidar_poses.csv").write_text("\n".join(rows) + "\n")
    return folder


HELIPR_POINTS = {
    "Ouster": ("<fff fIHHH", lambda k: (1.0, k, 7, 8, 9)),
    "Velodyne": ("<fff fHf", lambda k: (1.0, 5, k * 1e-9)),
    "Avia": ("<fff BBBI", lambda k: (1, 2, 3, k)),
    "Aeva": ("<fff ffiBf", lambda k: (1.0, 2.0, k, 3, 4.0)),
}


def helipr(root: Path, drive: Drive, *sensors: str, early: bool = False) -> Path:
    """LiDAR/SENSOR/*.bin, packed, and LiDAR_GT/global_SENSOR_gt.txt."""
    folder = made(root / "Roundabout01")
    shift = 0 if early else 100_000_000 * 10**9  # the Aeva's format changed in August 2023
    for sensor in sensors:
        layout, rest = HELIPR_POINTS[sensor]
        if early:
            layout, rest = "<fff ffiB", lambda k: (1.0, 2.0, k, 3)
        rows = []
        for i, T in enumerate(drive.poses):
            stamp = ns(drive.stamps[i]) + shift
            records = [struct.pack(layout, *point, *rest(0)) for point in drive.seen(i)]
            (made(folder / "LiDAR" / sensor) / f"{stamp}.bin").write_bytes(b"".join(records))
            values = [*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat()]
            rows.append(f"{stamp} " + " ".join(f"{v:.12g}" for v in values))
        truth = made(folder / "LiDAR_GT") / f"global_{sensor}_gt.txt"
        truth.write_text("\n".join(rows) + "\n")
    return folder


def nuscenes(root: Path, drive: Drive) -> Path:
    """A root with the tables of version v1.0-mini and one scene of sweeps."""
    mount = matrix((0.94, 0.0, 1.84), (0.01, 0.0, -1.57))
    tables: dict[str, list[dict[str, object]]] = {
        "scene": [{"token": "s", "name": "scene-0061"}],
        "sample": [{"token": "a", "scene_token": "s"}, {"token": "b", "scene_token": "other"}],
        "sensor": [{"token": "l", "channel": "LIDAR_TOP"}, {"token": "c", "channel": "CAM_FRONT"}],
        "calibrated_sensor": [
            {"token": "cl", "sensor_token": "l", **_posed(mount)},
            {"token": "cc", "sensor_token": "c", **_posed(np.eye(4))},
        ],
        "sample_data": [],
        "ego_pose": [],
    }
    for i, T in enumerate(drive.poses):
        name = f"sweeps/LIDAR_TOP/n__LIDAR_TOP__{us(drive.stamps[i])}.pcd.bin"
        points = drive.seen(i)
        made((root / name).parent)
        (root / name).write_bytes(float_rows(points, ones(points), ones(points)))
        for sensor, sample in (("cl", "a"), ("cc", "a"), ("cl", "b")):
            row = {"ego_pose_token": f"e{i}", "timestamp": us(drive.stamps[i]), "filename": name}
            row |= {"sample_token": sample, "calibrated_sensor_token": sensor}
            tables["sample_data"].insert(0, row)
        car = T @ geometry.inverse(mount)
        tables["ego_pose"].append({"token": f"e{i}", **_posed(car)})
    for name, rows in tables.items():
        (made(root / "v1.0-mini") / f"{name}.json").write_text(json.dumps(rows))
    return root


def _posed(T: Float64) -> dict[str, list[float]]:
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    return {"translation": T[:3, 3].tolist(), "rotation": [w, x, y, z]}
