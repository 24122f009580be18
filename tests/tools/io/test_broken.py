"""Broken files: one clear error each, quickly, and without taking memory on a header's word."""

from __future__ import annotations

import os
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from samples import io as io_samples
from samples.e57 import e57_file
from samples.io import cloud
from samples.walk import run

from segloc.errors import DatasetError
from segloc.tools.io import read_scan
from segloc.tools.io.clouds import read_cloud

SAMPLES = io_samples.samples(cloud(40))
# A cut through these can look like a smaller file, or one with a shorter last number.
HEADERLESS = ("kitti.bin", "plain.txt", "plain.xyz", "named.csv")
LAST_NUMBER = ("ascii.pcd",)
WITH_SOMETHING_BEHIND = ("ascii.ply", "little.ply", "ascii.vtk", "binary.vtk")


def read(folder: Path, name: str, data: bytes) -> int | None:
    """How many points are read, or None where the error is as it should be.

    What is refused as a scan is refused as a finished cloud, and the other way round.
    """
    path = folder / name
    path.write_bytes(data)
    as_cloud = counted(path, lambda: sum(len(part) for part in read_cloud(path)))
    as_scan = counted(path, lambda: len(scan := read_scan(path)) + scan.dropped)
    assert (as_cloud is None) == (as_scan is None)
    return as_scan


def counted(path: Path, count: Callable[[], int]) -> int | None:
    try:
        return count()
    except DatasetError as error:
        message = str(error)
        assert message.startswith(f"{path}: ")
        assert "\n" not in message
        assert len(message) < len(str(path)) + 300
        return None


@pytest.mark.parametrize("name", sorted(SAMPLES))
def test_truncated_anywhere(name: str, tmp_path: Path) -> None:
    data = SAMPLES[name]
    ends = sorted(
        {*range(0, len(data), max(1, len(data) // 150)), *range(len(data) - 25, len(data))}
    )
    counts = {end: read(tmp_path, name, data[:end]) for end in ends}
    for end, count in counts.items():
        if name in HEADERLESS:
            assert count is None or count <= 40
        elif name in WITH_SOMETHING_BEHIND or name.endswith((".laz", ".npz")):
            assert count in (None, 40), end  # the cut may lie behind the points
        elif name in LAST_NUMBER:
            assert count is None or (count == 40 and end > len(data) - 25), end
        else:
            assert count is None, end


GLIM = ("0/points_compact.bin", "0/data.txt")


def glim(folder: Path) -> Path:
    """Write a dump of one submap of 40 points."""
    (folder / "0").mkdir(parents=True)
    (folder / GLIM[0]).write_bytes(cloud(40).tobytes())
    rows = "".join(" ".join(map(str, row)) + "\n" for row in np.eye(4))
    (folder / GLIM[1]).write_text(f"id: 0\nT_world_origin: \n{rows}")
    return folder


@pytest.mark.parametrize("name", GLIM)
def test_a_dump_truncated_anywhere(name: str, tmp_path: Path) -> None:
    data = (glim(tmp_path / "dump") / name).read_bytes()
    for end in range(0, len(data) - 4, 7):
        (tmp_path / "dump" / name).write_bytes(data[:end])
        if name == GLIM[0] and end % 12 == 0:
            assert len(np.concatenate(list(read_cloud(tmp_path / "dump")))) == end // 12
            continue
        with pytest.raises(DatasetError, match=r"points_compact\.bin: .*(cut off|T_world_origin)"):
            list(read_cloud(tmp_path / "dump"))


@pytest.mark.parametrize("name", [*sorted(SAMPLES), "scans.e57", *GLIM])
def test_commands_refuse_truncated_clouds(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Half of a file ends in one line; if nothing tells that it is half, it shows too little."""
    if name == "scans.e57":
        pytest.importorskip("e57")
    made = {"scans.e57": partial(e57_file, (cloud(40), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))}
    path = glim(tmp_path) if name in GLIM else tmp_path / name
    data = (path / name).read_bytes() if name in GLIM else made.get(name, lambda: SAMPLES[name])()
    (tmp_path / name).write_bytes(data[: len(data) // 2 - 1])
    assert run("map", "from-cloud", path, "--out", tmp_path / "m.segmap") == 1
    *notes, line = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("segloc: error: ")
    assert all(each.startswith("segloc: note: ") for each in notes)
    assert str(path) in line or name in HEADERLESS
    assert run("doctor", path) == (name not in HEADERLESS or name.endswith(".bin"))


@pytest.mark.parametrize("name", sorted(SAMPLES))
def test_damaged_anywhere(name: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    for _ in range(150):
        data = bytearray(SAMPLES[name])
        for _ in range(rng.integers(1, 4)):
            where = int(rng.integers(0, min(len(data), 500 if rng.random() < 0.7 else 10**9)))
            kind = rng.integers(0, 4)
            if kind == 0:
                data[where] = rng.integers(0, 256)
            elif kind == 1:
                data[where : where + 4] = b"\xff" * 4
            elif kind == 2:
                data[where:where] = bytes(rng.integers(48, 58, 6, dtype=np.uint8))
            else:
                del data[where : where + 5]
        read(tmp_path, name, bytes(data))


@pytest.mark.parametrize("name", sorted(SAMPLES))
def test_another_format_or_noise_under_the_name(name: str, tmp_path: Path) -> None:
    noise = np.random.default_rng(1).bytes(4001)
    for data in (noise, b"\0" * 4001, b"1 1\n" * 1000 + b"1", b"x,y,z\n1,2\n"):
        assert read(tmp_path, name, data) is None
    if name not in ("kitti.bin", "plain.txt", "plain.xyz"):  # no header, so no points
        assert read(tmp_path, name, b"") is None
        assert read(tmp_path, name, b"\n" * 4001) is None


HUGE = "999999999999999999"
LIES = {
    "ascii.pcd": [(b"WIDTH 40", f"WIDTH {HUGE}"), (b"POINTS 40", f"POINTS {HUGE}")],
    "binary.pcd": [
        (b"WIDTH 40", f"WIDTH {HUGE}"),
        (b"COUNT 1 1 1", f"COUNT 1 1 1{HUGE}"),
        (b"SIZE 4 4 4", f"SIZE 4 4 {HUGE}"),
        (b"POINTS 40", "POINTS 41"),
        (b"WIDTH 40", "WIDTH -40"),
        (b"WIDTH 40", "WIDTH " + "9" * 5000),
        (b"FIELDS x y z", "FIELDS x y y"),
        (b"FIELDS x y z", "FIELDS x y"),
        (b"TYPE F F F", "TYPE F F Q"),
        (b"DATA binary", "DATA base64"),
    ],
    "compressed.pcd": [(b"WIDTH 40", f"WIDTH {HUGE}"), (b"POINTS 40", "POINTS 39")],
    "ascii.ply": [(b"vertex 40", f"vertex {HUGE}"), (b"vertex 40", "vertex 41")],
    "little.ply": [
        (b"vertex 40", f"vertex {HUGE}"),
        (b"property float z\n", "property float w\n"),
        (b"property float z\n", "property list uchar float z\n"),
        (b"property float z\n", "property quad z\n"),
        (b"element vertex", "element edge"),
        (b"binary_little_endian", "binary_middle_endian"),
    ],
    "big.ply": [
        (b"face 3", f"face {HUGE}"),
        (b"list uchar int", "list int int"),
        (b"list uchar int", "list float int"),
    ],
    "ascii.vtk": [(b"POINTS 40", f"POINTS {HUGE}"), (b"POINTS 40", "POINTS 300")],
    "binary.vtk": [(b"POINTS 40", f"POINTS {HUGE}"), (b" float\n", " string\n")],
    "array.npy": [
        (b"(40, 3)", f"({HUGE}, 3)"),
        (b"(40, 3)", f"({HUGE}, {HUGE}, 0)"),
        (b"(40, 3)", "(20, 6, 1)"),
        (b"(40, 3)", "(60, 2)"),
        (b"'<f4'", "'|O8'"),
        (b"'<f4'", "'<f3'"),
    ],
}


@pytest.mark.parametrize(
    ("name", "old", "new"), [(name, old, new) for name, lies in LIES.items() for old, new in lies]
)
def test_lies_in_a_text_header(name: str, old: bytes, new: str, tmp_path: Path) -> None:
    data = SAMPLES[name].replace(old, new.encode(), 1)
    if name == "array.npy":  # keep the length of its header right
        length = struct.unpack_from("<H", data, 8)[0] + len(data) - len(SAMPLES[name])
        data = data[:8] + struct.pack("<H", length) + data[10:]
    assert data != SAMPLES[name]
    tracemalloc.start()
    try:
        assert read(tmp_path, name, data) is None
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", ["plain.las", "timed.las", "chunked.laz", "layered.laz"])
@pytest.mark.parametrize("value", [0xFFFFFFFF, 0x7FFFFFFF, 100_000])
def test_lies_in_a_las_header(name: str, value: int, tmp_path: Path) -> None:
    data, start = SAMPLES[name], struct.unpack_from("<I", SAMPLES[name], 96)[0]
    places = {"offset to the points": 96, "number of records": 100, "legacy points": 107}
    if data[25] == 4:
        places["points"] = 247
        places.pop("legacy points")  # not what counts in version 1.4
    if name.endswith("laz"):
        table = struct.unpack_from("<q", data, start)[0]
        places |= {"chunk table": start, "chunks": table + 4}
    for place in places.values():
        lie = data[:place] + struct.pack("<I", value) + data[place + 4 :]
        assert read(tmp_path, name, lie) is None, place


def test_lies_about_compressed_sizes(tmp_path: Path) -> None:
    data = SAMPLES["compressed.pcd"]
    start = data.index(b"binary_compressed\n") + len(b"binary_compressed\n")
    for sizes in ((0xFFFFFFFF, 480), (10, 480), (10, 0xFFFFFFFF), (len(data), 480)):
        lie = data[:start] + struct.pack("<II", *sizes) + data[start + 8 :]
        assert read(tmp_path, "a.pcd", lie) is None
    # A header and sizes that agree on more than the stream could ever hold.
    header = data[:start].replace(b" 40\n", b" 300000000\n")
    lie = header + struct.pack("<II", 100, 3_600_000_000) + b"\xe0\xff\x00" * 34
    assert read(tmp_path, "a.pcd", lie) is None


def test_archives(tmp_path: Path) -> None:
    points = cloud(4)
    good = io_samples.npz(points=points, other=np.array(["text"]))
    assert read(tmp_path, "a.npz", good) == 4
    for arrays in (
        {"a": points, "b": points},
        {"points": points, "times": np.arange(3.0)},
        {"points": np.array([["a"] * 3])},
        {"times": np.arange(3.0)},
    ):
        assert read(tmp_path, "a.npz", io_samples.npz(**arrays)) is None
    place = good.index(b"PK\x01\x02")  # the directory's entry of points: its size is at 24
    lie = good[: place + 24] + struct.pack("<I", 0xFFFFFFF0) + good[place + 28 :]
    assert read(tmp_path, "a.npz", lie) is None
    with zipfile.ZipFile(tmp_path / "b.npz", "w", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("points.npy", io_samples.npy(points))
    with pytest.raises(DatasetError, match="unsupported compression"):
        read_scan(tmp_path / "b.npz")


def test_pickles_are_refused(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return os.mkdir, (str(tmp_path / "sprung"),)

    np.save(tmp_path / "a.npy", np.array([[Trap()] * 3], dtype=object), allow_pickle=True)
    with pytest.raises(DatasetError, match="not an array of numbers"):
        read_scan(tmp_path / "a.npy")
    assert not (tmp_path / "sprung").exists()


def test_paths_that_are_no_scans(tmp_path: Path) -> None:
    (tmp_path / "folder.ply").mkdir()
    os.mkfifo(tmp_path / "pipe.bin")
    (tmp_path / "photo.jpg").write_bytes(b"")
    for name, fault in (
        ("missing.pcd", "no such file"),
        ("folder.ply", "not a (regular )?file"),
        ("pipe.bin", "not a (regular )?file"),
        ("photo.jpg", "unknown format"),
        ("n\0ul.bin", "no such file|cannot read"),
        ("long" * 200 + ".bin", "cannot read"),
    ):
        with pytest.raises(DatasetError, match=fault):
            read_scan(tmp_path / name)
