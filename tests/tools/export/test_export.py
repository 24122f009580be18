"""Maps and results in the formats of others, read back by hand."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from samples.maps import make_map
from samples.walk import run
from scipy.spatial.transform import Rotation

from segloc import ConfigError, DatasetError, SegmentMap, geometry
from segloc.geometry import ros_covariance
from segloc.localization import Localized, NotLocalized, Reason
from segloc.loops import AlignConfig, Alignment
from segloc.loops.loops import Loop
from segloc.map.georeference import KEY, Georeference
from segloc.tools.batch import Evaluation
from segloc.tools.cli.align import write_alignment
from segloc.tools.cli.results import write_results
from segloc.tools.export import export
from segloc.tools.export.formats import Options
from segloc.tools.export.tracks import Place
from segloc.tools.inspect.alignment import RECORD, summary
from segloc.tools.io import Trajectory, read_scan, read_trajectory, write_tum
from segloc.types import Descriptors, Float64


def map_at(folder: Path, origin: tuple[float, float, float]) -> tuple[Path, Float64]:
    """A map with a cloud of 60 m around a point, and that cloud in the map's frame."""
    rng = np.random.default_rng(0)
    prior_map = SegmentMap.empty("geo", "f" * 16, 5, origin, cloud_voxel=0.25)
    cloud = prior_map.origin + rng.uniform(-30, 30, (500, 3))
    prior_map.add(
        Descriptors(rng.normal(size=(3, 5)).astype(np.float32)),
        prior_map.origin + rng.normal(size=(3, 3)),
        np.ones(3, np.int64),
        session=0,
        stamp=0.0,
        cloud=cloud,
    )
    way = np.stack([geometry.yaw_transform(0.1 * k, (3.0 * k, 1.0, 0.0)) for k in range(9)])
    way[5:, 0, 3] += 100.0  # the path is broken there
    way[:, :3, 3] += prior_map.origin
    prior_map.add_trajectory(way)
    prior_map.save(folder / "site.segmap")
    return folder / "site.segmap", prior_map.cloud.astype(np.float64) + prior_map.origin


def turned(x: float, yaw: float, roll: float) -> Float64:
    T = geometry.yaw_transform(yaw, (x, 0.5 * x, 0.1))
    T[:3, :3] = T[:3, :3] @ Rotation.from_euler("x", roll).as_matrix()
    return T


@pytest.fixture
def aligned(tmp_path: Path) -> tuple[Path, Alignment]:
    """Two sessions of four scans that one loop connects, another that was rejected, and a third."""
    indices = [np.array([10, 11, 12, 20]), np.array([0, 1, 2, 3]), np.array([5, 6])]
    tracks = [
        np.stack([turned(2.0 * k + 50 * s, 0.2 * k, 0.05 * k) for k in range(len(i))])
        for s, i in enumerate(indices)
    ]
    rng = np.random.default_rng(3)
    half = rng.normal(size=(6, 6))
    covariance = 1e-3 * (half @ half.T + np.eye(6))
    T = geometry.yaw_transform(0.3, (1.0, 2.0, 0.0))
    # Submaps are numbered through all sessions; a loop names them, and the scans they stand at.
    loops = [
        Loop(1, 4, T, covariance, "found", 9, 0.8, weight=0.9),
        Loop(0, 5, T, covariance, "found", 4, 0.3, reason="too little overlap"),
    ]
    ends = np.array([[0, 1], [0, 1]]), np.array([[12, 2], [10, 3]])
    found = Alignment(
        ["a", "b", "c"], indices, tracks, [T @ t for t in tracks], [[0, 1], [2]], loops, *ends
    )
    out = tmp_path / "aligned"
    write_alignment(out, found, AlignConfig(), summary(found))
    return out, found


@pytest.mark.parametrize("origin", [(100.0, -20.0, 3.0), (4.5e5, 5.4e6, 310.0)])
@pytest.mark.parametrize("kind", ["pcd", "ply", "laz"])
def test_a_cloud_is_written_where_the_map_is_or_its_shift_is_told(
    tmp_path: Path, kind: str, origin: tuple[float, float, float]
) -> None:
    path, cloud = map_at(tmp_path, origin)
    out = tmp_path / f"site.{kind}"
    notes = export(path, kind, out)
    far = origin[0] > 1e5
    if kind == "laz":
        laspy = pytest.importorskip("laspy")
        assert not notes
        assert np.abs(np.asarray(laspy.read(out).xyz) - cloud).max() < 0.001
        return
    shift = np.array(origin) if far else np.zeros(3)
    assert len(notes) == far and (not far or "(450000, 5400000, 310)" in notes[0])
    assert np.abs(read_scan(out).points + shift - cloud).max() < 0.001


def test_autoware_gets_tiles_that_hold_each_point_once(tmp_path: Path) -> None:
    path, cloud = map_at(tmp_path, (100.0, -20.0, 3.0))
    assert export(path, "autoware", tmp_path / "out", Options(tile_m=25.0)) == []
    facts = yaml.safe_load((tmp_path / "out/pointcloud_map_metadata.yaml").read_text())
    assert facts.pop("x_resolution") == facts.pop("y_resolution") == 25.0
    folder = tmp_path / "out/pointcloud_map.pcd"
    assert sorted(facts) == sorted(p.name for p in folder.iterdir()) and len(facts) >= 9
    parts = []
    for name, corner in facts.items():
        points = read_scan(folder / name).points
        inside = points[:, :2] - np.array(corner)
        assert len(points) and (inside >= 0).all() and (inside < 25.0).all()
        assert np.allclose(np.array(corner) % 25.0, 0)
        parts.append(points)
    everything = np.concatenate(parts)
    order, expected = np.lexsort(everything.T), np.lexsort(cloud.astype(np.float32).T)
    assert np.allclose(everything[order], cloud[expected], atol=1e-3)
    with pytest.raises(Exception, match=r"contains .* choose a new folder"):
        export(path, "autoware", tmp_path / "out")


def g2o_of(path: Path) -> tuple[dict[int, Float64], list[tuple[int, int, Float64, Float64]]]:
    """Vertices and edges, read by g2o's documentation, by hand."""

    def pose(words: list[str]) -> Float64:
        x, y, z, *q = map(float, words)
        return geometry.rigid(Rotation.from_quat(q).as_matrix(), np.array([x, y, z]))

    vertices, edges = {}, []
    for line in path.read_text().splitlines():
        tag, *words = line.split()
        if tag == "VERTEX_SE3:QUAT":
            assert len(words) == 8
            vertices[int(words[0])] = pose(words[1:])
        elif tag == "EDGE_SE3:QUAT":
            assert len(words) == 2 + 7 + 21
            information = np.zeros((6, 6))
            information[np.triu_indices(6)] = list(map(float, words[9:]))
            information += np.triu(information, 1).T
            edges.append((int(words[0]), int(words[1]), pose(words[2:9]), information))
        else:
            assert tag == "FIX"
    return vertices, edges


def test_a_pose_graph_is_what_g2o_reads(tmp_path: Path, aligned: tuple[Path, Alignment]) -> None:
    path, found = aligned
    export(path, "g2o", tmp_path / "graph.g2o")
    vertices, edges = g2o_of(tmp_path / "graph.g2o")
    assert sorted(vertices) == list(range(10))
    for k, T in enumerate(np.concatenate(found.poses)):
        assert np.allclose(vertices[k], T, atol=1e-7)
    fixed = re.findall(r"^FIX (\d+)$", (tmp_path / "graph.g2o").read_text(), re.M)
    assert fixed == ["0", "8"]
    assert [(a, b) for a, b, *_ in edges] == [
        *((0, 1), (1, 2), (2, 3), (4, 5), (5, 6), (6, 7), (8, 9)),
        (2, 6),  # scans 12 and 2: the rejected loop is not told
    ]
    a, b, T, _ = edges[1]
    track = found.odometry[0]
    assert np.allclose(T, np.linalg.inv(track[a]) @ track[b], atol=1e-7)
    assert_measures(edges[-1], found)


def assert_measures(edge: tuple[int, int, Float64, Float64], found: Alignment) -> None:
    """The loop is between sensors, and its information that of a small error of g2o's kind."""
    _, _, T, information = edge
    level = [
        geometry.inverse(geometry.levelled(P)) @ P
        for P in (found.odometry[0][2], found.odometry[1][2])
    ]
    loop = found.loops[0]
    assert np.allclose(level[0] @ T @ np.linalg.inv(level[1]), loop.T_target_source, atol=1e-7)
    # By small errors themselves: a turn and a shift at the source's sensor, in the level frame.
    rng = np.random.default_rng(1)
    for _ in range(5):
        turn, shift = 1e-4 * rng.normal(size=(2, 3))
        off = geometry.rigid(Rotation.from_rotvec(turn).as_matrix(), shift)
        delta = np.concatenate([off[:3, 3], Rotation.from_matrix(off[:3, :3]).as_quat()[:3]])
        there = level[1][:3, :3]
        moved = np.concatenate([there @ turn, there @ shift])
        mine = moved @ np.linalg.inv(loop.covariance) @ moved
        assert delta @ information @ delta == pytest.approx(mine, rel=1e-5)


def test_loops_are_told_between_scans(tmp_path: Path, aligned: tuple[Path, Alignment]) -> None:
    path, _ = aligned
    export(path, "loops", tmp_path / "loops.jsonl")
    (line,) = (tmp_path / "loops.jsonl").read_text().splitlines()
    loop = json.loads(line)
    assert list(loop) == list(RECORD)
    assert (loop["target_session"], loop["target_scan"]) == (0, 12)
    assert (loop["source_session"], loop["source_scan"]) == (1, 2)
    assert len((path / "loops.jsonl").read_text().splitlines()) == 2


def results(folder: Path, timed: bool) -> Path:
    folder.mkdir()
    stamps = np.arange(4.0) + (1.7e9 + 0.25 if timed else 0.0)
    remark = "" if timed else "no times: the first column is the scan number"
    poses = np.stack([turned(3.0 * k, 0.1 * k, 0.0) for k in range(4)])
    write_tum(folder / "poses.tum", Trajectory(stamps, poses), remark)
    (folder / "states.jsonl").write_text("{}\n")
    return folder


@pytest.mark.parametrize("timed", [True, False])
def test_poses_by_time_of_each_kind_of_source(tmp_path: Path, timed: bool) -> None:
    found = results(tmp_path / "found", timed)
    export(found, "tum", tmp_path / "out.tum")
    text = (tmp_path / "out.tum").read_text()
    assert text.splitlines()[-1].startswith("1700000003.25" if timed else "3.000000000 ")
    assert ("no times" in text) != timed
    path, _ = map_at(tmp_path, (100.0, -20.0, 3.0))
    export(path, "tum", tmp_path / "map.tum")
    assert len(read_trajectory(tmp_path / "map.tum")) == 9


def test_aligned_sessions_are_a_file_each(tmp_path: Path, aligned: tuple[Path, Alignment]) -> None:
    path, found = aligned
    export(path, "tum", tmp_path / "out")
    for k, poses in enumerate(found.poses):
        track = read_trajectory(tmp_path / f"out/session_{k}.tum")
        assert np.array_equal(track.stamps, found.indices[k])
        assert np.allclose(track.poses, poses, atol=1e-7)


def test_paths_are_lines_that_break_where_the_path_does(tmp_path: Path) -> None:
    path, _ = map_at(tmp_path, (100.0, -20.0, 3.0))
    (note,) = export(path, "geojson", tmp_path / "a.geojson", Options())
    assert "--at" in note
    (feature,) = json.loads((tmp_path / "a.geojson").read_text())["features"]
    lines = feature["geometry"]["coordinates"]
    assert feature["geometry"]["type"] == "MultiLineString" and [len(x) for x in lines] == [5, 4]
    assert lines[0][0] == [100.0, -19.0, 3.0]
    assert export(path, "geojson", tmp_path / "b.geojson", Options(epsg=32632)) == []
    crs = json.loads((tmp_path / "b.geojson").read_text())["crs"]
    assert crs["properties"]["name"] == "urn:ogc:def:crs:EPSG::32632"
    # A degree of latitude at 49 degrees is 111.22 km, one of longitude 73.17 km.
    place = Place.parse("49.0,8.4")
    lonlat = place.degrees(np.array([[731.7, 0.0], [0.0, 1112.2]]))
    assert np.allclose(lonlat, [[8.41, 49.0], [8.4, 49.01]], atol=2e-6)
    assert export(path, "geojson", tmp_path / "c.geojson", Options(place=place)) == []
    far, _ = map_at(tmp_path, (689_000.0, 5_330_000.0, 3.0))
    with pytest.raises(ConfigError, match="5330 km: build a map in projected coordinates"):
        export(far, "geojson", tmp_path / "d.geojson", Options(place=place))
    with pytest.raises(ConfigError, match="--cloud-frame is for tum and geojson, not for ply"):
        export(path, "ply", tmp_path / "e.ply", Options(in_cloud=True))


def found_in(folder: Path, prior_map: SegmentMap, stamp: float) -> Localized:
    """Write results of two queries, of which the first is localized."""
    rng = np.random.default_rng(5)
    half = rng.normal(size=(6, 6))
    covariance = 1e-4 * (half @ half.T + np.eye(6))
    T = turned(30.0, 0.5, 0.0)
    found = Localized(T_map_sensor=T, covariance=covariance, confidence=0.99, stamp=stamp)
    lost = NotLocalized(reason=Reason("ambiguous"), message="so", stamp=stamp + 1.0)
    scored = Evaluation(np.array([7, 9]), [found, lost], prior_map)
    write_results(folder, prior_map, scored, {})
    return found


def test_poses_found_are_points_with_what_is_known_of_them(tmp_path: Path) -> None:
    prior_map = SegmentMap.empty("geo", "f" * 16, 5)
    where = Georeference(25832, (691_600.0, 5_336_000.0, 520.0))
    prior_map.metadata[KEY] = where.to_text()
    found = found_in(tmp_path / "found", prior_map, 1.7e9 + 0.25)
    out = tmp_path / "a.geojson"
    assert export(tmp_path / "found", "geojson", out, Options(epsg=25832)) == []
    (feature,) = json.loads(out.read_text())["features"]
    assert feature["geometry"]["type"] == "Point"
    at = np.array(feature["geometry"]["coordinates"])
    assert at - where.origin_m == pytest.approx(found.T_map_sensor[:3, 3], abs=1e-3)
    known = feature["properties"]
    assert (known["name"], known["index"], known["stamp"]) == ("found", 7, 1.7e9 + 0.25)
    assert known["time"] == "2023-11-14T22:13:20.250+00:00"
    assert known["yaw_deg"] == pytest.approx(np.degrees(0.5), abs=0.01)
    assert known["confidence"] == 0.99
    expected = ros_covariance(found.covariance, found.T_map_sensor)
    assert np.array(known["covariance"]) == pytest.approx(expected, rel=1e-3)
    with pytest.raises(ConfigError, match="the map is in EPSG:25832"):
        export(tmp_path / "found", "geojson", out, Options(epsg=25833))
    pytest.importorskip("pyproj")
    assert export(tmp_path / "found", "geojson", out) == []
    (feature,) = json.loads(out.read_text())["features"]
    back = where.in_map(np.array([feature["geometry"]["coordinates"]]))
    assert back[0] == pytest.approx(found.T_map_sensor[:3, 3], abs=2e-3)


def test_a_drive_is_a_line_and_its_poses(tmp_path: Path) -> None:
    found = results(tmp_path / "drive", True)
    T = turned(3.0, 0.1, 0.0)
    states = [{"index": 0}, {"index": 1, "stamp": 2.0, "T_map_base": T.tolist()}]
    (found / "states.jsonl").write_text("".join(json.dumps(state) + "\n" for state in states))
    export(found, "geojson", tmp_path / "a.geojson")
    line, point = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert line["geometry"]["type"] == "MultiLineString" and line["properties"]["poses"] == 4
    assert point["geometry"]["coordinates"] == [3.0, 1.5, 0.1]
    assert point["properties"]["index"] == 1 and point["properties"]["covariance"] is None
    for damaged in ([[1, 2]], "text", np.zeros((4, 4)).tolist()):
        (found / "states.jsonl").write_text(json.dumps({"T_map_base": damaged}))
        with pytest.raises(DatasetError, match=r"states\.jsonl: T_map_base: damaged"):
            export(found, "geojson", tmp_path / "a.geojson")


def test_poses_in_a_levelled_cloud_are_brought_into_its_own_frame(tmp_path: Path) -> None:
    prior_map, T_map_cloud = SegmentMap.empty("geo", "f" * 16, 5), turned(4.0, 0.3, 0.2)
    prior_map.metadata["T_map_cloud"] = json.dumps(T_map_cloud.tolist())
    T_cloud_sensor = (
        np.linalg.inv(T_map_cloud) @ found_in(tmp_path / "found", prior_map, 3.0).T_map_sensor
    )
    options = Options(in_cloud=True)
    export(tmp_path / "found", "tum", tmp_path / "a.tum", options)
    assert read_trajectory(tmp_path / "a.tum").poses[0] == pytest.approx(T_cloud_sensor, abs=1e-8)
    (note,) = export(tmp_path / "found", "geojson", tmp_path / "a.geojson", options)
    (feature,) = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert "metres" in note and feature["properties"]["time"] is None
    assert feature["geometry"]["coordinates"] == pytest.approx(T_cloud_sensor[:3, 3], abs=1e-3)


def test_viewpoints_of_a_finished_cloud_are_no_drive(tmp_path: Path) -> None:
    path, _ = map_at(tmp_path, (100.0, -20.0, 3.0))
    prior_map = SegmentMap.load(path)
    prior_map.metadata["source"] = "cloud"
    prior_map.add_trajectory(np.stack([np.eye(4)] * 3))
    prior_map.save(path)
    export(path, "geojson", tmp_path / "a.geojson")
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    kinds = [(f["geometry"]["type"], len(f["properties"])) for f in features]
    assert kinds == [("MultiLineString", 2), ("MultiPoint", 2)]
    assert [features[0]["properties"]["poses"], features[1]["properties"]["viewpoints"]] == [8, 4]
    (note,) = export(path, "tum", tmp_path / "a.tum")
    assert note == "4 viewpoints of these poses were chosen in a cloud, not driven"


def test_what_makes_no_sense_is_one_clear_line(
    tmp_path: Path, aligned: tuple[Path, Alignment], capsys: pytest.CaptureFixture[str]
) -> None:
    make_map().save(tmp_path / "site.segmap")
    site, found = tmp_path / "site.segmap", results(tmp_path / "found", True)
    (tmp_path / "empty").mkdir()
    for source, to, expected in (
        (site, "g2o", "needs results of `segloc align`, and this is a map"),
        (site, "loops", "needs results of `segloc align`, and this is a map"),
        (found, "pcd", "needs a map, and this is results of `segloc localize` or `segloc live`"),
        (aligned[0], "autoware", "needs a map, and this is results of `segloc align`"),
        (site, "dxf", "supported: pcd, ply, laz"),
        (tmp_path / "empty", "tum", "neither a map nor results"),
        (tmp_path / "nowhere", "tum", "no such file"),
    ):
        capsys.readouterr()
        assert run("export", source, "--to", to, "--out", tmp_path / "out") == 1
        error = capsys.readouterr().err
        assert error.startswith("segloc: error: ") and error.count("\n") == 1
        assert expected in error, error
        assert not (tmp_path / "out").exists()
    assert run("export", site, "--to", "ply", "--out", tmp_path / "site.ply") == 0
    with pytest.raises(ConfigError, match="exclude each other"):
        export(site, "geojson", tmp_path / "x", Options(epsg=1, place=Place(1.0, 1.0)))
    for text in ("49", "a,b", "99,8", "nan,1"):
        with pytest.raises(ConfigError, match="--at"):
            Place.parse(text)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("alignment.json", "{"),
        ("alignment.json", "[]"),
        ("alignment.json", '{"sessions": [], "components": [[0]]}'),
        ("loops.jsonl", '{"accepted": true}\n'),
        ("loops.jsonl", '{"accepted": true, "target_session": 9, "target_scan": 0}\n'),
        ("loops.jsonl", "nonsense\n"),
    ],
)
def test_damaged_results_are_refused_by_name(
    tmp_path: Path, aligned: tuple[Path, Alignment], name: str, text: str
) -> None:
    (aligned[0] / name).write_text(text)
    with pytest.raises(DatasetError, match=name):
        export(aligned[0], "g2o", tmp_path / "x.g2o")
