"""Maps that are brought up to date: what is gone goes, what was not in view stays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from segloc_lab.simulation import (
    Conditions,
    Route,
    SimulatedSequence,
    World,
    hdl64e,
    simulate_session,
    town,
)
from segloc_lab.simulation.drives import mapped_way

from segloc import Config, Scan, SeglocError, SegmentMap, build_map, geometry
from segloc.cli import main
from segloc.errors import DatasetError, MapMismatch
from segloc.io import Trajectory, write_scan, write_tum
from segloc.loops import Reposed
from segloc.map.compact import CompactConfig
from segloc.map.config import MappingConfig
from segloc.map.update import UpdateConfig, update_map
from segloc.map.visibility import visibility
from segloc.types import Descriptors, Float64

pytestmark = pytest.mark.slow

# With every view, so that there is much to count.
CONFIG = Config(threads=1, mapping=MappingConfig(compact=CompactConfig(enabled=False)))
REPLACED = Conditions(replaced=0.6)


class Screen:
    """Scans of a wall 20 m ahead and of a post 10 m ahead, or of the wall alone."""

    name = "screen"

    def __init__(self, post: bool, count: int = 6) -> None:
        self.post = post
        self.indices = np.arange(count, dtype=np.int64)
        self.stamps = None
        self.poses = np.stack([geometry.yaw_transform(0, (0.0, 1.5 * k, 0)) for k in range(count)])

    def __len__(self) -> int:
        return len(self.indices)

    def scan(self, i: int) -> Scan:
        """What a sensor with a ray every half degree sees of them, 8 rays high."""
        y0 = float(self.poses[i, 1, 3])
        azimuth, elevation = np.meshgrid(
            np.radians(np.arange(-45, 45, 0.5)), np.radians(np.arange(-4, 4, 0.5))
        )
        depth = np.full(azimuth.shape, 20.0)
        if self.post:
            across = y0 + 10.0 * np.tan(azimuth)
            depth[np.abs(across - 4.0) < 0.5] = 10.0
        points = np.stack(
            [depth, depth * np.tan(azimuth), depth / np.cos(azimuth) * np.tan(elevation)], axis=-1
        )
        return Scan(points.reshape(-1, 3), T_odom_sensor=self.poses[i])


def _places() -> NDArray[np.float32]:
    """On the post, on the wall behind it, behind the wall, and out of every scan's view."""
    return np.array([[10, 4, 0], [20, 4, 0], [28, 4, 0], [-10, 4, 0]], np.float32)


def test_what_is_looked_through_is_gone_and_what_is_hidden_is_not() -> None:
    origin = np.array([0.0, 0.0, 0.0])
    without = visibility(_places(), origin, Screen(post=False))
    assert without.gone.tolist() == [True, False, False, False]
    assert without.seen.tolist() == [False, True, False, False]
    with_it = visibility(_places(), origin, Screen(post=True))
    assert with_it.gone.tolist() == [False] * 4
    assert with_it.seen.tolist() == [True, True, False, False]
    few = visibility(_places(), origin, Screen(post=False, count=2))
    assert not few.gone.any()  # two looks are too few
    moved = np.array([1e6, -2e6, 100.0])
    far = Reposed(Screen(post=False), geometry.rigid(np.eye(3), moved) @ Screen(post=False).poses)
    assert visibility(_places(), moved, far).gone.tolist() == without.gone.tolist()


def test_without_poses_there_is_nothing_to_judge() -> None:
    screen = Screen(post=True)
    screen.poses = None  # type: ignore[assignment]
    with pytest.raises(DatasetError, match="screen: needs a pose"):
        visibility(_places(), np.zeros(3), screen)


class Remembered:
    """A simulated drive whose scans are cast once."""

    def __init__(self, drive: SimulatedSequence) -> None:
        self.name, self.indices, self.poses = drive.name, drive.indices, drive.poses
        self.stamps = drive.stamps
        self._scans: list[Scan] = []
        self.object_ids: list[NDArray[np.int32]] = []
        for i in range(len(drive)):
            self._scans.append(drive.scan(i))
            self.object_ids.append(drive.object_ids(i))  # of the scan just cast

    def __len__(self) -> int:
        return len(self._scans)

    def scan(self, i: int) -> Scan:
        scan = self._scans[i]
        return Scan(scan.points, stamp=scan.stamp, T_odom_sensor=self.poses[i])


@pytest.fixture(scope="module")
def world() -> World:
    pytest.importorskip("embreex")
    return town(5, size_m=220.0)


def _drive(world: World, session: int, length_m: float) -> Remembered:
    way = tuple(mapped_way(world, np.random.default_rng([2, 31]), 120.0))
    route = Route(way, 0.5 * session, 2.0, length_m)
    conditions = REPLACED if session else Conditions()
    return Remembered(
        simulate_session(world, session, route, hdl64e(300), 2, conditions=conditions)
    )


@pytest.fixture(scope="module")
def first(world: World) -> Remembered:
    return _drive(world, 0, 90.0)


@pytest.fixture(scope="module")
def later(world: World) -> Remembered:
    """Half of the way, after things were replaced."""
    return _drive(world, 1, 36.0)


@pytest.fixture(scope="module")
def prior_map(first: Remembered) -> SegmentMap:
    return build_map(first, CONFIG)


def _objects(prior_map: SegmentMap, drive: Remembered) -> NDArray[np.int64]:
    """The true object of each point of the map's cloud."""
    points, ids = [], []
    for i in range(len(drive)):
        points.append(geometry.transform(drive.poses[i], drive.scan(i).points[::2]))
        ids.append(drive.object_ids[i][::2])
    _, nearest = cKDTree(np.concatenate(points)).query(prior_map.cloud + prior_map.origin)
    return np.concatenate(ids)[nearest].astype(np.int64)


def test_replaced_objects_go_and_all_others_stay(
    world: World, first: Remembered, later: Remembered, prior_map: SegmentMap
) -> None:
    objects = _objects(prior_map, first)
    present = np.array(sorted(world.session(1, REPLACED).kinds))
    lasting = objects[(objects > 0) & (objects < 1_000_000)]
    there = np.isin(objects, present) & (objects > 0)
    replaced = np.isin(objects, np.setdiff1d(np.unique(lasting), present))
    judged = visibility(prior_map.cloud, prior_map.origin, later)
    assert judged.gone[replaced].sum() > 300
    assert judged.gone[there].mean() < 0.001
    assert judged.gone[objects == 0].mean() < 0.001  # the ground

    once, counts = update_map(prior_map, later, CONFIG)
    assert counts.removed == 0
    assert counts.aged > 50
    assert counts.seen > 5 * counts.aged
    assert counts.out_of_view > 200
    assert len(once) == len(prior_map) + counts.added
    waiting = once.missed == 1
    assert waiting.sum() == counts.aged
    twice, second = update_map(once, later, CONFIG)
    assert second.removed >= 0.9 * counts.aged
    assert (twice.missed < 2).all()
    far = (
        np.linalg.norm(prior_map.centroids[:, None] - later.poses[None, :, :3, 3], axis=2).min(1)
        > 60
    )
    assert far.sum() > 50
    kept = {row.tobytes() for row in twice.centroids}
    assert all(row.tobytes() in kept for row in prior_map.centroids[far])
    # The cloud of what is gone is gone, too, and that of the rest is there.
    tree = cKDTree(twice.cloud + twice.origin)
    distances, _ = tree.query(prior_map.cloud + prior_map.origin)
    assert np.median(distances[replaced & judged.gone]) > 0.3
    assert np.percentile(distances[there], 99) < 0.3


def test_what_is_seen_again_is_missed_no_longer(first: Remembered, prior_map: SegmentMap) -> None:
    every = np.ones(len(prior_map), dtype=bool), np.ones(len(prior_map.cloud), dtype=bool)
    missed = prior_map.kept(*every, np.ones(len(prior_map), np.int32))
    updated, counts = update_map(missed, first, CONFIG)
    assert counts.removed == 0
    assert counts.aged == 0
    assert counts.seen > 0.8 * len(prior_map)
    assert (updated.missed[: len(prior_map)] == 0).sum() == counts.seen


def test_poses_of_another_frame_are_refused(later: Remembered, prior_map: SegmentMap) -> None:
    frame = geometry.yaw_transform(0.1)
    with pytest.raises(SeglocError, match=r"% of the map in view is not there"):
        update_map(prior_map, Reposed(later, frame @ later.poses), CONFIG)


def _little_map(missed: list[int]) -> SegmentMap:
    prior_map = SegmentMap.empty("geo", "f", 2)
    for k in range(len(missed)):
        prior_map.add(
            Descriptors(np.full((1, 2), k, np.float32)),
            np.array([[0.1 * k, 0, 0]]),
            [10],
            session=k,
            stamp=k,
            cloud=np.array([[float(k), 0, 0]]),
        )
    full = np.ones(len(missed), dtype=bool)
    return prior_map.kept(full, full, np.array(missed))


def test_missed_is_kept_on_disk_and_by_merging(tmp_path: Path) -> None:
    prior_map = _little_map([0, 1, 0])
    prior_map.save(tmp_path / "a.segmap")
    again = SegmentMap.load(tmp_path / "a.segmap")
    assert again.missed.tolist() == [0, 1, 0]
    assert again.merge(again).missed.tolist() == [0, 1, 0]
    fresh = _little_map([0, 0, 2])
    assert sorted(prior_map.merge(fresh).missed.tolist()) == [0, 1, 2]
    assert sorted(fresh.merge(prior_map).missed.tolist()) == [0, 1, 2]
    _little_map([0, 0, 0]).save(tmp_path / "b.segmap")
    assert b'"missed"' not in (tmp_path / "b.segmap").read_bytes()
    assert SegmentMap.load(tmp_path / "b.segmap").missed.tolist() == [0, 0, 0]
    with pytest.raises(SeglocError, match="masks of shapes"):
        prior_map.kept(np.ones(2, dtype=bool), np.ones(3, dtype=bool))


def test_the_size_is_bounded(later: Remembered, prior_map: SegmentMap) -> None:
    newest, counts = update_map(prior_map, later, CONFIG, UpdateConfig(max_views=3))
    assert counts.bounded > 0
    near = cKDTree(newest.centroids).query_ball_point(newest.centroids, 0.25)
    assert max(len(each) for each in near) <= 6  # two leaders may share a place
    small, counts = update_map(prior_map, later, CONFIG, UpdateConfig(max_segments=500))
    assert len(small) == 500
    assert (small.session == 1).all()  # the newest stay


def test_the_command(
    later: Remembered,
    prior_map: SegmentMap,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    for i in range(0, len(later), 2):
        write_scan(folder / f"{i:04d}.npy", later.scan(i).points)
    stamps: Float64 = later.indices.astype(np.float64)
    write_tum(folder / "aligned.tum", Trajectory(stamps, later.poses))
    prior_map.save(tmp_path / "old.segmap")
    argv = ["segloc", "map", "update", "old.segmap", "run", "--poses", "aligned.tum"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", [*argv, "--out", "new.segmap", "--max-missed", "1"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code in (0, None)
    assert "removed" in capsys.readouterr().out
    new = SegmentMap.load("new.segmap")
    assert len(np.unique(new.session)) == 2
    assert (new.missed == 0).all()


def test_another_place_is_refused_unless_told(later: Remembered, prior_map: SegmentMap) -> None:
    far = geometry.yaw_transform(0.0, (1000.0, 0.0, 0.0))
    with pytest.raises(MapMismatch, match=r"meet nowhere.*--elsewhere"):
        update_map(prior_map, Reposed(later, far @ later.poses), CONFIG)
    joined, counts = update_map(
        prior_map, Reposed(later, far @ later.poses), CONFIG, elsewhere=True
    )
    assert len(joined) == len(prior_map) + counts.added


def test_a_frame_that_is_off_by_metres_is_refused(later: Remembered, prior_map: SegmentMap) -> None:
    for shift in ((9.0, 9.0, 0.0), (-7.0, 7.0, 0.0)):
        off = Reposed(later, geometry.yaw_transform(0.5, shift) @ later.poses)
        with pytest.raises(SeglocError, match=r"in two frames|is not there|meet nowhere"):
            update_map(prior_map, off, CONFIG)
