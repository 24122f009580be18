"""Finished clouds of every format; tests/docs/test_coming_from.py has the layouts of software."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from samples.e57 import e57_file
from samples.io import pcd, ply

from segloc import DatasetError, geometry
from segloc.tools.io import clouds, text, write_scan
from segloc.tools.io.clouds import cloud_files, count_points, read_cloud
from segloc.tools.io.las import format_laz
from segloc.types import Float64

UTM = np.array([500_000.0, 5_400_000.0, 300.0])


@pytest.fixture
def points() -> Float64:
    return np.round(np.random.default_rng(0).uniform(-20, 20, (2500, 3)), 3)


def read(path: Path) -> Float64:
    return np.concatenate(list(read_cloud(path)))


def rows(points: Float64) -> np.ndarray:
    return np.rec.fromarrays([np.zeros(len(points), "<f4"), *points.T], names="red,x,y,z")


def ply_after_list(points: Float64) -> bytes:
    """A PLY file whose vertices come after a row with a list."""
    head = (
        "ply\nformat binary_little_endian 1.0\nelement strip 1\nproperty list uchar int at\n"
        f"element vertex {len(points)}\n"
        + "".join(f"property double {axis}\n" for axis in "xyz")
        + "end_header\n"
    )
    return head.encode() + b"\x01" + bytes(4) + points.astype("<f8").tobytes()


def npz(points: Float64) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, points=points)
    return buffer.getvalue()


WHOLE = "c.pcd", "c.ply", "a.vtk", "a.npz"
"""Files of the test below that are not read in parts."""


@pytest.mark.parametrize(
    "name", ["a.pcd", "b.pcd", "a.ply", "b.ply", "a.laz", "a.xyz", "a.csv", *WHOLE]
)
def test_utm_coordinates_are_read_in_parts_to_a_millimetre(
    tmp_path: Path, points: Float64, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clouds, "PART", 1000)
    monkeypatch.setattr(text, "_BLOCK", 40_000)
    there = points + UTM
    lines = "".join(f"{x:.3f} {y:.3f} {z:.3f} 9\n" for x, y, z in there)
    data = {
        "a.pcd": lambda: pcd(rows(there), "binary"),
        "b.pcd": lambda: pcd(rows(there), "ascii"),
        "c.pcd": lambda: pcd(rows(there), "binary_compressed"),
        "a.ply": lambda: ply(rows(there), "binary_big_endian", faces=[]),
        "b.ply": lambda: ply(rows(there), "ascii", faces=[]),
        "c.ply": lambda: ply_after_list(there),
        "a.vtk": lambda: (
            b"# vtk DataFile Version 3.0\n\nBINARY\nDATASET POLYDATA\n"
            b"POINTS 2500 double\n" + there.astype(">f8").tobytes()
        ),
        "a.npz": lambda: npz(there),
        "a.laz": lambda: format_laz(there, offset=UTM),
        "a.xyz": lambda: f"2500\n{lines}".encode(),
        "a.csv": lambda: f"X,Y,Z,i\n{lines.replace(' ', ',')}".encode(),
    }[name]()
    (tmp_path / name).write_bytes(data)
    parts = list(read_cloud(tmp_path / name))
    assert len(parts) == 1 if name in WHOLE else len(parts) >= 3
    if name not in ("a.vtk", "a.npz"):  # whose headers are not read
        assert count_points(tmp_path / name) == pytest.approx(2500, rel=0.001)
    assert np.abs(np.concatenate(parts) - there).max() < 1.1e-3


def test_scans_of_an_e57_file_are_read_where_they_stand(tmp_path: Path, points: Float64) -> None:
    pytest.importorskip("e57")
    quarter_turn = (0.5**0.5, 0.0, 0.0, 0.5**0.5)
    T = geometry.yaw_transform(np.pi / 2, (UTM[0], UTM[1], UTM[2]))
    inside = geometry.transform(geometry.inverse(T), points[100:])
    scans = (points[:100], (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), (inside, quarter_turn, (*UTM,))
    (tmp_path / "a.e57").write_bytes(e57_file(*scans))
    assert np.abs(read(tmp_path / "a.e57") - points).max() < 1e-6
    assert count_points(tmp_path / "a.e57") == len(points)
    (tmp_path / "b.e57").write_bytes(b"ASTM-E57" + bytes(100))
    with pytest.raises(DatasetError, match=r"b\.e57: cannot read the E57 file"):
        read(tmp_path / "b.e57")


def test_files_of_several_folders_are_placed_by_their_poses(
    tmp_path: Path, points: Float64
) -> None:
    names = [f"{folder}/{k}.ply" for folder in "ba" for k in (2, 10, 11)]
    poses = np.stack([geometry.yaw_transform(0.3 * k, (k, 2.0, 1.0)) for k in range(len(names))])
    parts = np.array_split(points, len(names))
    for name, T, part in zip(names, poses, parts, strict=True):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write_scan(tmp_path / name, geometry.transform(geometry.inverse(T), part))
    (tmp_path / "a" / "._2.ply").write_bytes(bytes(100))  # what a Mac leaves beside copies
    given = [tmp_path / "b", tmp_path / "a", tmp_path / "b" / "2.ply"]
    files = cloud_files(given)
    assert files == [tmp_path / name for name in names]
    assert [count_points(file) for file in files] == [len(part) for part in parts]
    assert np.abs(np.concatenate(list(read_cloud(given, poses=poses))) - points).max() < 1e-4
    with pytest.raises(DatasetError, match="5 poses for 6 files"):
        next(read_cloud(given, poses=poses[:5]))
