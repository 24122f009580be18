"""Map updates: drop what is gone, keep what was not in view."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from samples.maps import make_map
from samples.plaza import Plaza, PlazaSequence
from samples.walk import as_folder, run
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from segloc import Config, MemoryRecording, Scan, SeglocError, SegmentMap, build_map, geometry
from segloc.errors import DatasetError, MapMismatch
from segloc.joining.update import UpdateConfig, update_map
from segloc.joining.visibility import VisibilityConfig, visibility
from segloc.loops import Reposed
from segloc.map.compact import CompactConfig
from segloc.map.config import MappingConfig
from segloc.types import Descriptors

pytestmark = pytest.mark.slow

# With every view, so that there is much to count.
CONFIG = Config.preset("geo").model_copy(
    update={"threads": 1, "mapping": MappingConfig(compact=CompactConfig(enabled=False))}
)


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


def test_free_space_is_known_from_all_directions_about_a_ray() -> None:
    """Past a point goes one ray, but another beside it ends as near."""
    beside, past = np.radians([-0.5, 0.5])
    poses = [geometry.yaw_transform(0.0, (0.01 * k, 0.0, 0.0)) for k in range(4)]
    for heading in np.radians(np.arange(-180, 180, 15)):
        ends = [
            [r * np.cos(heading + a), r * np.sin(heading + a), 0.0]
            for r, a in ((25.0, beside), (29.0, past), (25.0, past))
        ]
        drive = MemoryRecording([Scan(np.array(ends[:2]))] * 4, poses=np.stack(poses))
        place = np.array(ends[2:], np.float32)
        assert not visibility(place, np.zeros(3), drive, VisibilityConfig(every_m=0.005)).gone.any()


def test_without_poses_there_is_nothing_to_judge() -> None:
    screen = Screen(post=True)
    screen.poses = None  # type: ignore[assignment]
    with pytest.raises(DatasetError, match=r"screen: .*needs a pose"):
        visibility(_places(), np.zeros(3), screen)


def replaced(k: int) -> bool:
    """Whether a box of the plaza was removed before the later session."""
    return k % 3 == 0


def scene(changed: bool) -> Plaza:
    """A plaza within a round wall, with or without the boxes that were removed."""
    plaza = Plaza(0)
    angle, z = np.meshgrid(np.linspace(0, 2 * np.pi, 1000), np.arange(0.0, 6.0, 0.2))
    wall = np.column_stack([30 * np.cos(angle.ravel()), 30 * np.sin(angle.ravel()), z.ravel()])
    ground, *boxes = plaza.parts
    kept = (box for k, box in enumerate(boxes) if not (changed and replaced(k)))
    plaza.points = np.vstack([ground, wall, *kept])[::4]
    return plaza


@pytest.fixture(scope="module")
def first() -> PlazaSequence:
    return PlazaSequence(scene(changed=False), steps=10)


@pytest.fixture(scope="module")
def later() -> PlazaSequence:
    """A walk on a parallel line, after a third of the boxes was removed."""
    walk = PlazaSequence(scene(changed=True), steps=8)
    walk.poses[:, 1, 3] += 2.0
    return walk


@pytest.fixture(scope="module")
def prior_map(first: PlazaSequence) -> SegmentMap:
    return build_map(first, CONFIG)


def _distances(points: NDArray[np.float64], removed: bool) -> NDArray[np.float64]:
    """Distances to the boxes that were removed, or to those that were not."""
    boxes = Plaza(0).parts[1:]
    chosen = np.vstack([b for k, b in enumerate(boxes) if replaced(k) == removed])
    found: NDArray[np.float64] = cKDTree(chosen).query(points)[0]
    return found


def _within_the_wall(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether something lies behind each point, so that its absence can be seen."""
    found: NDArray[np.bool_] = np.hypot(points[:, 0], points[:, 1]) < 28.0
    return found


def test_removed_objects_go_and_all_others_stay(
    later: PlazaSequence, prior_map: SegmentMap
) -> None:
    points = prior_map.cloud + prior_map.origin
    there = _distances(points, False) < 0.2
    gone = (_distances(points, True) < 0.2) & ~there & _within_the_wall(points)
    results = visibility(prior_map.cloud, prior_map.origin, later)
    assert results.gone[gone].mean() > 0.6 and results.gone[there].mean() < 0.001

    once, counts = update_map(prior_map, later, CONFIG)
    assert counts.removed == 0 and counts.aged >= 10 and counts.seen > 200
    assert len(once) == len(prior_map) + counts.added
    assert (once.missed == 1).sum() == counts.aged
    twice, second = update_map(once, later, CONFIG)
    assert second.removed >= 0.9 * counts.aged and (twice.missed < 2).all()
    kept = {row.tobytes() for row in twice.centroids}
    stays = np.array([row.tobytes() in kept for row in prior_map.centroids])
    removed, others = (_distances(prior_map.centroids, which) for which in (True, False))
    assert stays[others < 0.5].all()
    replaced_ones = (removed < 1.0) & (others > 3.0) & _within_the_wall(prior_map.centroids)
    assert replaced_ones.sum() >= 10 and stays[replaced_ones].mean() < 0.2
    distances, _ = cKDTree(twice.cloud + twice.origin).query(points)
    assert np.median(distances[gone & results.gone]) > 0.3
    assert np.percentile(distances[there], 99) < 0.3

    again, counts = update_map(once, PlazaSequence(scene(changed=False), steps=8), CONFIG)
    assert counts.removed == 0 and (again.missed == 0).all()  # what is seen again is not missed


def test_poses_of_another_frame_or_place_are_refused(
    later: PlazaSequence, prior_map: SegmentMap
) -> None:
    far_off = geometry.yaw_transform(0.0, (1000.0, 0.0, 0.0))
    with pytest.raises(MapMismatch, match=r"1000\.00 m .*degrees off the map"):
        update_map(prior_map, Reposed(later, far_off @ later.poses), CONFIG, elsewhere=True)
    other = PlazaSequence(Plaza(5), steps=8)
    far = Reposed(other, far_off @ other.poses)
    with pytest.raises(MapMismatch, match="--elsewhere"):
        update_map(prior_map, far, CONFIG)
    joined, counts = update_map(prior_map, far, CONFIG, elsewhere=True)
    assert len(joined) == len(prior_map) + counts.added


def test_the_command(later: PlazaSequence, prior_map: SegmentMap, tmp_path: Path) -> None:
    folder = as_folder(tmp_path / "run", later, "aligned.tum")
    old, out = tmp_path / "old.segmap", tmp_path / "new.segmap"
    prior_map.save(old)
    posed = ("--poses", "aligned.tum")
    assert run("map", "update", old, folder, *posed, "--out", out, "--max-missed", 1) == 0
    new = SegmentMap.load(out)
    assert len(np.unique(new.session)) == 2
    assert (new.missed == 0).all()


def _little_map(missed: list[int]) -> SegmentMap:
    made = make_map(len(missed), segments=1)
    return made.kept(np.ones(len(made), bool), np.ones(len(made.cloud), bool), np.array(missed))


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


def test_the_size_is_bounded(later: PlazaSequence, prior_map: SegmentMap) -> None:
    newest, counts = update_map(prior_map, later, CONFIG, UpdateConfig(max_views=3))
    assert counts.bounded > 0
    near = cKDTree(newest.centroids).query_ball_point(newest.centroids, 0.25)
    assert max(len(each) for each in near) <= 6  # two leaders may share a place
    small, counts = update_map(prior_map, later, CONFIG, UpdateConfig(max_segments=100))
    assert len(small) == 100
    assert (small.session == 1).all()  # the newest stay


def test_a_map_that_is_updated_again_and_again_hardly_grows(first: PlazaSequence) -> None:
    config = CONFIG.model_copy(update={"mapping": MappingConfig()})  # compact
    bounded = every = build_map(first, config)
    sizes = [len(bounded)]
    for k in range(1, 5):
        again = PlazaSequence(scene(changed=False), steps=5)
        again.poses[:, 1, 3] += 0.3 * k
        bounded, _ = update_map(bounded, again, config, unchecked=True)
        every, _ = update_map(every, again, config, UpdateConfig(max_views=0), unchecked=True)
        sizes.append(len(bounded))
    assert sizes[4] - sizes[2] < 0.5 * (sizes[2] - sizes[0])
    assert len(every) > 1.5 * len(bounded)


def test_a_session_in_the_frame_of_a_levelled_map_is_not_levelled_again(
    first: PlazaSequence,
) -> None:
    """Even if what it sees leans."""
    tilt = geometry.rigid(Rotation.from_euler("y", 2.0, degrees=True).as_matrix(), np.zeros(3))
    mapping = CONFIG.mapping.model_copy(update={"level": True})
    tilted = Reposed(first, tilt @ first.poses)
    site = build_map(tilted, CONFIG.model_copy(update={"mapping": mapping}))
    T_map_odom = np.array(json.loads(site.metadata["T_map_odom"]))
    leaning = Reposed(first, geometry.inverse(tilt) @ T_map_odom @ tilted.poses)
    updated, _ = update_map(site, leaning, unchecked=True)
    new = updated.trajectory[len(site.trajectory) :]
    assert len(new) and all(np.abs(leaning.poses - T).max(axis=(1, 2)).min() < 1e-9 for T in new)


def test_no_session_gets_the_number_of_one_that_is_gone(later: PlazaSequence) -> None:
    site = build_map(PlazaSequence(scene(changed=False), steps=8), CONFIG)
    gone = np.array([0.0, 0.0, 1.0])
    ghost = SegmentMap.empty(
        site.descriptor, site.fingerprint, site.dim, site.origin, cloud_voxel=site.cloud_voxel
    )
    one = Descriptors(site.vectors[:1], None if site.quality is None else site.quality[:1])
    cloud = gone + np.random.default_rng(0).uniform(-0.4, 0.4, (60, 3))
    ghost.add(one, gone[None], [60], session=0, stamp=5000.0, cloud=cloud)
    both = site.merge(ghost)
    assert both.session.max() == 1
    updated, counts = update_map(both, later, CONFIG, UpdateConfig(max_missed=1), unchecked=True)
    assert counts.removed >= 1 and set(np.unique(updated.session)) == {0, 2}
