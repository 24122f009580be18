"""Every format, every layout: what is read is what was written."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from samples import io as io_samples
from samples.io import cloud

from segloc.errors import DatasetError, InvalidScan, SeglocError
from segloc.tools.io import read_scan, write_scan
from segloc.tools.io.clouds import read_cloud
from segloc.tools.io.kitti_bin import parse_kitti
from segloc.tools.io.pcd import parse_pcd
from segloc.tools.io.ply import parse_ply
from segloc.tools.io.text import parse_csv, parse_txt

clouds = hnp.arrays(
    np.float32,
    st.tuples(st.integers(0, 60), st.just(3)),
    elements=st.floats(-1000, 1000, width=32),
)


@pytest.mark.parametrize("name", sorted(io_samples.samples(cloud(5))))
def test_reads_what_another_writer_wrote(name: str, tmp_path: Path) -> None:
    for count in (50, 1, 0):
        points = cloud(count)
        path = tmp_path / name
        path.write_bytes(io_samples.samples(points)[name])
        scan = read_scan(str(path))
        tolerance = 6e-4 if name.endswith(("las", "laz")) else 0
        assert scan.points.dtype == np.float32
        np.testing.assert_allclose(
            scan.points, points, rtol=1e-7 if tolerance else 0, atol=tolerance
        )
        timed = name in ("timed.las", "chunked.laz", "layered.laz") and count > 1
        assert (scan.times is not None) == (timed or name == "arrays.npz")


@settings(max_examples=25, deadline=None)
@given(points=clouds, suffix=st.sampled_from([".bin", ".pcd", ".ply", ".npy", ".csv", ".laz"]))
def test_written_scans_come_back(
    points: np.ndarray[Any, Any], suffix: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("scan") / f"cloud{suffix}"
    write_scan(path, points)
    again = read_scan(path).points
    if suffix == ".laz":
        np.testing.assert_allclose(again, points, atol=6e-4)
    else:
        np.testing.assert_array_equal(again, points)
    assert [each.name for each in path.parent.iterdir()] == [path.name]
    first = path.read_bytes()
    write_scan(path, points)
    assert path.read_bytes() == first


def test_writing_refuses_what_it_cannot_keep(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"cloud\.las: cannot write this format"):
        write_scan(tmp_path / "cloud.las", cloud())
    with pytest.raises(SeglocError, match="no folder"):
        write_scan(tmp_path / "missing" / "cloud.npy", cloud())
    with pytest.raises(InvalidScan):
        write_scan(tmp_path / "cloud.npy", np.zeros((4, 2)))
    with pytest.raises(DatasetError, match=r"cloud\.laz: coordinates more than 2147 km"):
        write_scan(tmp_path / "cloud.laz", np.full((1, 3), 3e6))
    write_scan(tmp_path / "cloud.npy", np.array([[1.0, 2.0, 3.0], [np.nan, 0, 0]]))
    assert len(read_scan(tmp_path / "cloud.npy")) == 1
    assert [each.name for each in tmp_path.iterdir()] == ["cloud.npy"]


layouts = st.lists(
    st.sampled_from(
        [("intensity", "<f4"), ("ring", "<u2"), ("pad", "u1", (4,)), ("pad", "u1", (10,)),
         ("label", "<i8"), ("normal", "<f8", (3,))]
    ),
    max_size=4,
)  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(
    extra=layouts,
    order=st.permutations(range(8)),
    axes=st.sampled_from(["<f4", "<f8", "<i2", "<i4"]),
    time=st.sampled_from([None, ("t", "<u4"), ("time", "<f4"), ("timestamp", "<f8")]),
    encoding=st.sampled_from(["ascii", "binary", "binary_compressed"]),
    count=st.integers(0, 40),
)
def test_pcd_of_any_layout(
    extra: list[Any], order: list[int], axes: str, time: Any, encoding: str, count: int
) -> None:
    fields = [(axis, axes) for axis in "xyz"]
    fields += [
        (f"{name}{i}" if name == "pad" or i else name, *rest)
        for i, (name, *rest) in enumerate(extra)
    ]
    fields += [time] if time else []
    dtype = np.dtype([fields[i] for i in order if i < len(fields)])
    rng = np.random.default_rng(count)
    rows = np.frombuffer(rng.integers(0, 60, count * dtype.itemsize, dtype=np.uint8), dtype).copy()
    for axis in "xyz":
        rows[axis] = rng.integers(-1000, 1000, count)
    scan = parse_pcd(io_samples.pcd(rows, encoding))
    np.testing.assert_array_equal(scan.points, np.stack([rows[axis] for axis in "xyz"], axis=1))
    if time is None:
        assert scan.times is None
    else:
        factor = 1e-9 if time[1] == "<u4" else 1.0
        np.testing.assert_allclose(scan.times, rows[time[0]].astype(np.float64) * factor)


@settings(max_examples=60, deadline=None)
@given(data=st.binary(max_size=300) | st.binary(max_size=4).map(lambda word: word * 200))
def test_lzf_gives_back_what_was_compressed(data: bytes) -> None:
    from segloc._native import lzf_decompress

    packed = np.frombuffer(io_samples.lzf_compress(data), np.uint8)
    assert lzf_decompress(packed, len(data)).tobytes() == data
    with pytest.raises(ValueError, match=r"corrupt|too short"):
        lzf_decompress(packed, len(data) + 1)


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("faces_first", [False, True])
def test_ply_of_any_order_and_layout(order: str, faces_first: bool) -> None:
    dtype = np.dtype(
        [("red", "u1"), ("z", "<f8"), ("y", "<f8"), ("t", "<u4"), ("x", "<f8"), ("id", "<i2")]
    )
    rows = np.zeros(20, dtype)
    for i, axis in enumerate("xyz"):
        rows[axis] = cloud(20)[:, i]
    rows["t"] = np.arange(20) * 1000
    faces = [[1, 2, 3]] * 5 + [[], [1], list(range(19))]
    scan = parse_ply(io_samples.ply(rows, order, faces=faces, faces_first=faces_first))
    np.testing.assert_array_equal(scan.points, cloud(20))
    np.testing.assert_allclose(scan.times, np.arange(20) * 1e-6)


def test_points_that_are_not_finite_go_with_their_times(tmp_path: Path) -> None:
    points = cloud(6).astype(np.float64)
    points[[1, 4], [0, 2]] = np.nan, np.inf
    points[3, 1] = 1e300  # beyond float32
    rows = np.rec.fromarrays([*points.T, np.arange(6.0)], names="x,y,z,time")
    files = {"a.npz": io_samples.npz(points=points, times=np.arange(6.0))}
    files |= {f"{e}.pcd": io_samples.pcd(rows, e) for e in ("ascii", "binary", "binary_compressed")}
    for order in ("ascii", "binary_little_endian", "binary_big_endian"):
        files[f"{order}.ply"] = io_samples.ply(rows, order, faces=[])
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
        scan = read_scan(tmp_path / name)
        assert scan.dropped == 3
        assert scan.times.tolist() == [0, 2, 5], name
        np.testing.assert_array_equal(scan.points, cloud(6)[[0, 2, 5]])


def test_text_tables() -> None:
    expected = np.array([[1, 2, 3], [4, 5, 6.5]])
    for text in (
        "1,2,3\n4,5,6.5", "1 2 3 9\r\n\r\n4 5 6.5 9\r\n", "z;x;y\n3;1;2\n6.5;4;5\n",
        '\ufeff"X","Y","label","Z"\n1,2,wall,3\n4,5,tree,6.5\n', "1\t2\t3\n4\t5\t6.5",
        "x , y , z\n1 , 2 , 3 \n 4,5 ,6.5\n",
    ):  # fmt: skip
        np.testing.assert_array_equal(parse_csv(text.encode()).points, expected)
    np.testing.assert_array_equal(parse_txt(b"// c\n# d\n1 2 3\n#e\n4 5 6.5").points, expected)
    for timed in (
        parse_csv(b"Time,x,y,z\n0.5,1,2,3\n0.75,4,5,6.5"),
        parse_txt(b"# a drive\n# t x y z\n0.5 1 2 3\n0.75 4 5 6.5"),
    ):
        np.testing.assert_array_equal(timed.points, expected)
        assert timed.times.tolist() == [0.5, 0.75]


@pytest.mark.parametrize("order", "CF")
@pytest.mark.parametrize("dtype", ["<f2", ">f4", "<f8", "<i4", "u1"])
def test_npy_of_any_dtype_and_order(dtype: str, order: Any, tmp_path: Path) -> None:
    array = np.asarray(np.arange(20).reshape(5, 4), dtype=dtype, order=order)
    np.save(tmp_path / "a.npy", array)
    np.testing.assert_array_equal(read_scan(tmp_path / "a.npy").points, array[:, :3])
    np.savez(tmp_path / "a.npz", anything=array)
    np.testing.assert_array_equal(read_scan(tmp_path / "a.npz").points, array[:, :3])


@pytest.mark.parametrize("width", [3, 4, 5])
@pytest.mark.parametrize("shuffled", [False, True])
def test_bin_of_other_widths_is_recognised(width: int, shuffled: bool) -> None:
    rng = np.random.default_rng(width)
    rows = np.hstack([cloud(6000), rng.uniform(size=(6000, 1)), rng.integers(0, 32, (6000, 1))])
    rows = rows[:, :width] if shuffled else rows[rows[:, 2].argsort(), :width]
    for count in (6000, 3000, 600, 240):  # all of them divisible by 3, 4 and 5
        np.testing.assert_array_equal(
            parse_kitti(rows[:count].astype("<f4").tobytes()).points,
            rows[:count, :3].astype(np.float32),
        )


@pytest.mark.parametrize("width", [6, 7, 8])
def test_a_bin_of_more_columns_is_refused(width: int) -> None:
    rng = np.random.default_rng(width)
    more = [rng.uniform(0, 255, 8400), np.arange(8400) % 32, np.linspace(0, 0.1, 8400)]
    more += [rng.uniform(size=8400), rng.integers(0, 3, 8400)]
    rows = np.column_stack([cloud(8400) * (9, 9, 1), *more])[:, :width]
    with pytest.raises(DatasetError, match=f"rows of {width} float32"):
        parse_kitti(rows.astype("<f4").tobytes())


def test_deleted_points_of_a_laz_are_left_out_and_feet_are_refused(tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    points, path = cloud(1000), tmp_path / "a.laz"
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales = [0.001] * 3
    las = laspy.LasData(header)
    las.xyz, las.gps_time = points, np.arange(1000.0)
    las.withheld = deleted = np.arange(1000) % 5 == 0
    las.write(path)
    scan = read_scan(path)
    assert np.abs(scan.points - points[~deleted]).max() < 1e-3
    assert np.array_equal(scan.times, np.flatnonzero(~deleted))
    assert sum(map(len, read_cloud(path))) == 800
    wkt = 'PROJCS["here",GEOGCS["there",UNIT["degree",0.0174]],UNIT["{}",0.3]]'
    keys = np.array([[1, 1, 0, 1], [3076, 0, 1, 9003]], "<u2").tobytes()
    for vlr in (
        laspy.VLR("LASF_Projection", 2112, "", wkt.format("US survey foot").encode()),
        laspy.VLR("LASF_Projection", 34735, "", keys),
    ):
        las.header.vlrs[:] = [vlr]
        las.write(path)
        with pytest.raises(DatasetError, match=r"foot'.*convert it to metres"):
            read_scan(path)
        with pytest.raises(DatasetError, match=r"a\.laz: .*foot"):
            list(read_cloud(path))
    las.header.vlrs[:] = [laspy.VLR("LASF_Projection", 2112, "", wkt.format("metre").encode())]
    las.write(path)
    assert len(read_scan(path)) == 800


def test_an_empty_bin_is_an_empty_scan_and_nuscenes_has_five_columns(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(b"")
    assert len(read_scan(tmp_path / "a.bin")) == 0
    rows = np.arange(20, dtype="<f4").reshape(4, 5)
    (tmp_path / "A.PCD.BIN").write_bytes(rows.tobytes())
    np.testing.assert_array_equal(read_scan(tmp_path / "A.PCD.BIN").points, rows[:, :3])


@pytest.mark.parametrize("unit", [1e9, 1e30])
def test_a_bin_of_something_else_is_refused(unit: float, tmp_path: Path) -> None:
    path = tmp_path / "0.bin"
    path.write_bytes((cloud(190) * unit).astype("<f4").tobytes())  # 2280 bytes: 120 of 19
    with pytest.raises(DatasetError, match=r"not a KITTI scan; .* HeLiPR's Avia: open the"):
        read_scan(path)
    path.write_bytes(bytes(29 * 7))
    with pytest.raises(DatasetError, match=r"of float32; 203 bytes fit .* HeLiPR's Aeva: open the"):
        read_scan(path)


@pytest.mark.parametrize("order", ["<", ">"])
def test_lists_beside_the_coordinates_of_a_ply(order: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(700, 3)).astype(np.float32)
    counts = np.where(np.arange(700) < 400, 2, rng.integers(0, 5, 700))
    kind = "binary_little_endian" if order == "<" else "binary_big_endian"
    header = (
        f"ply\nformat {kind} 1.0\nelement vertex 700\nproperty float x\nproperty list uchar int v\n"
        "property float y\nproperty float z\nelement face 0\nproperty list uchar int w\n"
        "end_header\n"
    )
    rows = [
        struct.pack(f"{order}fB{n}iff", p[0], n, *range(n), p[1], p[2])
        for p, n in zip(points, counts.tolist(), strict=True)
    ]
    (tmp_path / "a.ply").write_bytes(header.encode() + b"".join(rows))
    np.testing.assert_array_equal(read_scan(tmp_path / "a.ply").points, points)
    (tmp_path / "a.ply").write_bytes(header.encode() + b"".join(rows)[:-1])
    with pytest.raises(DatasetError, match=r"a\.ply: .* bytes"):
        read_scan(tmp_path / "a.ply")
    text = header.replace(kind, "ascii").replace(
        "property list uchar int v\nproperty float y\nproperty float z\n",
        "property float y\nproperty float z\nproperty list uchar int v\n",
    )
    lines = [
        " ".join(map(repr, [*map(float, p), n, *range(n)])) + "\n"
        for p, n in zip(points, counts.tolist(), strict=True)
    ]
    (tmp_path / "b.ply").write_text(text + "".join(lines))
    np.testing.assert_array_equal(read_scan(tmp_path / "b.ply").points, points)


PLAIN = "1 2 3 9\n4 5 6 9\n"


@pytest.mark.parametrize(
    ("name", "text", "count"),
    [
        ("a.pts", f"2\n{PLAIN}", 2),
        ("a.asc", f"//X Y Z I\n{PLAIN}", 2),
        ("titled.csv", "//X,Y,Z,I\n1,2,3,9\n4,5,6,9\n", 2),
        ("a.xyz", f"X Y Z I\n{PLAIN}", 2),
        ("a.csv", "X,Y,Z\n1,2,3\n4,5,6\n", 2),
        ("a.txt", f"{PLAIN}-nan(ind) nan(0x8000) -NAN(IND) 0\n1.#QNAN -1.#IND 1.#INF00 0\n", 2),
        ("a.xyz", f"-nan(ind) -nan(ind) -nan(ind) 0\n{PLAIN}", 2),
    ],
)
def test_text_as_other_programs_write_it(name: str, text: str, count: int, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    scan = read_scan(tmp_path / name)
    np.testing.assert_array_equal(scan.points, [[1, 2, 3], [4, 5, 6]])
    assert len(scan) == count


@pytest.mark.parametrize(
    ("fields", "kind", "size", "encoding"),
    [
        ("X Y Z", "F F F", "WIDTH 2\nHEIGHT 1", "binary"),
        ("x y z", "f f f", "WIDTH 2\nHEIGHT 1", "BINARY"),
        ("x y z", "F F F", "WIDTH 0\nHEIGHT 0", "binary"),
    ],
)
def test_headers_of_pcd_as_other_programs_write_them(
    fields: str, kind: str, size: str, encoding: str, tmp_path: Path
) -> None:
    points = np.arange(6, dtype="<f4").reshape(2, 3)
    header = (
        f"VERSION 0.7\nFIELDS {fields}\nSIZE 4 4 4\nTYPE {kind}\nCOUNT 1 1 1\n{size}\n"
        f"POINTS 2\nDATA {encoding}\n"
    )
    (tmp_path / "a.pcd").write_bytes(header.encode() + points.tobytes())
    np.testing.assert_array_equal(read_scan(tmp_path / "a.pcd").points, points)
