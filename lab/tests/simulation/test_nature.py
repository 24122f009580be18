"""Parks, meadows and forests: repeatable, consistent, passable, and seen as nature is."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samples.worlds import made_anew
from scipy.spatial import cKDTree

pytest.importorskip("embreex", reason="simulation needs the extra sim")

from segloc_lab.simulation import (
    Conditions,
    Route,
    Scene,
    World,
    forest,
    hdl32e,
    meadow,
    park,
    simulate_session,
)
from segloc_lab.simulation.objects.mesh import LEAF, SOLID, Mesh, Objects, triangles
from segloc_lab.simulation.objects.scene import Hits, Terrain
from segloc_lab.simulation.objects.vegetation import EVERGREEN, SPECIES, grow

from segloc.errors import ConfigError
from segloc.frontend.local_cloud import Accumulator
from segloc.frontend.segmentation import Segmenter

pytestmark = pytest.mark.slow

SIZES = {"park": 160.0, "meadow": 140.0, "forest": 120.0}
MAKERS: dict[str, Callable[..., World]] = {"park": park, "meadow": meadow, "forest": forest}
EXPECTED = {
    "park": {"house", "tree", "bench", "lamp", "shrubs"},
    "meadow": {"tree", "bush", "thicket", "grass"},
    "forest": {"tree", "sapling", "thicket", "log", "stump", "fern"},
}


@pytest.fixture(scope="module", params=sorted(MAKERS))
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def world(kind: str) -> World:
    return MAKERS[kind](5, size_m=SIZES[kind])


# --- worlds ---------------------------------------------------------------------------------------


def test_a_world_is_a_function_of_its_seed(kind: str, world: World) -> None:
    again = made_anew(MAKERS[kind], 5, SIZES[kind])
    for name in ("triangles", "reflectance", "material", "object_ids"):
        np.testing.assert_array_equal(getattr(again.static, name), getattr(world.static, name))
    np.testing.assert_array_equal(again.terrain.heights, world.terrain.heights)
    np.testing.assert_array_equal(again.spots.people, world.spots.people)
    other = MAKERS[kind](6, size_m=SIZES[kind])
    assert other.static.triangles.shape != world.static.triangles.shape
    data = pickle.dumps(world)
    assert len(data) < 500
    assert pickle.loads(data).static.kinds == world.static.kinds


def test_objects_are_sound(kind: str, world: World) -> None:
    static = world.static
    assert np.isfinite(static.triangles).all()
    assert len(static.triangles) == len(static.object_ids) == len(static.material)
    assert set(np.unique(static.object_ids)) == set(static.kinds)
    assert EXPECTED[kind] <= set(static.kinds.values())
    assert ((static.reflectance > 0) & (static.reflectance <= 1)).all()
    top = static.triangles[..., 2].max() - world.terrain.heights.min()
    assert 6 < top < 60
    assert (np.ptp(static.triangles, axis=1).max(axis=1) < 40).all()


def test_no_two_trees_are_alike(world: World) -> None:
    static = world.static
    starts = np.flatnonzero(np.diff(static.object_ids, prepend=-1))
    low = np.minimum.reduceat(static.triangles.min(axis=1), starts)
    high = np.maximum.reduceat(static.triangles.max(axis=1), starts)
    size = (high - low)[[static.kinds[int(static.object_ids[k])] == "tree" for k in starts]]
    gap, _ = cKDTree(size).query(size, 2)
    assert len(size) > 15
    assert gap[:, 1].min() > 1e-3


def test_routes_are_clear(world: World) -> None:
    rng = np.random.default_rng(1)
    route = world.roads.walk(rng, [0], 350.0, avoid=[])
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    around = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(48)]).astype(np.float32)
    fixed = Scene(world.terrain, world.ground_reflectance, [world.static])
    changed = world.session(2, Conditions(replaced=0.4))
    for lane, scene in ((-2.0, fixed), (2.0, fixed), (0.8, fixed), (1.1, changed)):
        poses = Route(tuple(route), lane_offset_m=lane, spacing_m=0.5).poses(world, 1.73)
        origins = np.repeat(poses[:, :3, 3], 48, axis=0).astype(np.float32)
        hits = scene.cast(origins, np.tile(around, (len(poses), 1)), 5.0)
        assert hits.ranges[hits.object_ids > 0].min() > 0.7
        climb = np.diff(poses[:, 2, 3]) / 0.5
        assert np.abs(climb).max() < 0.35


@pytest.mark.parametrize("maker", [park, meadow, forest])
@pytest.mark.parametrize(("seed", "size_m"), [(0, 20.0), (0, 5000.0), (0, float("nan")), (-1, 200)])
def test_impossible_worlds_are_refused(
    maker: Callable[..., World], seed: int, size_m: float
) -> None:
    with pytest.raises(ConfigError):
        maker(seed, size_m=size_m)


# --- what a LiDAR makes of them -------------------------------------------------------------------


def test_segments_repeat_from_the_other_direction(world: World) -> None:
    rng = np.random.default_rng(2)
    way = world.roads.walk(rng, [0], 60.0, avoid=[])
    sensor = hdl32e(720)
    first = simulate_session(world, 0, Route(tuple(way), lane_offset_m=0.8), sensor, 1)
    back = simulate_session(world, 1, Route(tuple(way[::-1]), lane_offset_m=0.8), sensor, 2)
    here = len(first) // 2
    there = int(np.linalg.norm(back.truth[:, :3, 3] - first.truth[here, :3, 3], axis=1).argmin())
    sets = []
    for drive, middle in ((first, here), (back, there)):
        scans = [drive.scan(k) for k in range(max(0, middle - 5), min(len(drive), middle + 6))]
        cloud = Accumulator().gather(scans, reference=min(5, middle))
        T = drive.truth[middle] @ np.linalg.inv(cloud.T_local_sensor)
        middles = Segmenter().segment(cloud).segments.centroids
        sets.append(middles @ T[:3, :3].T + T[:3, 3])
    near = sets[0][np.linalg.norm(sets[0] - first.truth[here, :3, 3], axis=1) < 25]
    distance, _ = cKDTree(sets[1]).query(near)
    assert len(near) >= 12
    assert (distance < 0.5).mean() > 0.4


def test_leaves_fall_in_winter_and_wood_stays(world: World) -> None:
    bare = world.static.with_foliage(0.0)
    leaves = world.static.material == LEAF
    assert 0.1 < leaves.mean() < 0.95
    assert len(bare.triangles) == (~leaves).sum()
    trees = {k for k, kind in world.static.kinds.items() if kind == "tree"}
    assert trees <= set(bare.kinds)
    assert world.session(0, Conditions(foliage=0.0)) is not world.session(0)


# --- trees ----------------------------------------------------------------------------------------


@given(
    kind=st.sampled_from(sorted(SPECIES)),
    seed=st.integers(0, 10_000),
    detail=st.floats(0.1, 1.0),
    scale=st.floats(0.4, 1.2),
)
@settings(max_examples=60, deadline=None)
def test_any_tree_stands_on_the_ground(kind: str, seed: int, detail: float, scale: float) -> None:
    tree = grow(np.random.default_rng(seed), kind, detail=detail, scale=scale)
    assert np.isfinite(tree.triangles).all()
    low, high = tree.triangles[..., 2].min(), tree.triangles[..., 2].max()
    assert -1.5 < low <= -0.29
    assert 0.5 * SPECIES[kind].height[0] * scale < high < 1.5 * SPECIES[kind].height[1] * scale
    if kind != "sapling":  # the smallest may have no leaf
        assert ((tree.material == LEAF).any()) == (kind not in EVERGREEN | {"snag"})
    trunk = tree.triangles[: 9 * 2, :, :2]
    assert np.linalg.norm(trunk, axis=-1).max() < 0.25 * high + 0.5


def crown_hits(mesh: Mesh, foliage: float = 1.0) -> tuple[Hits, float]:
    """What level rays meet of the upper half of a tree, and the share that meets anything."""
    flat = Terrain(np.full(2, -50.0), 100.0, np.full((2, 2), -5.0))
    group = Objects.of([("tree", mesh)], 1).with_foliage(foliage)
    scene = Scene(flat, np.full(2, 0.4, dtype=np.float32), [group])
    top = mesh.triangles[..., 2].max()
    y, z = np.meshgrid(np.linspace(-1.5, 1.5, 60), np.linspace(0.55 * top, 0.85 * top, 60))
    origins = np.column_stack([np.full(y.size, -30.0), y.ravel(), z.ravel()]).astype(np.float32)
    ways = np.tile(np.array([[1.0, 0.0, 0.0]], dtype=np.float32), (len(origins), 1))
    hits = scene.cast(origins, ways, 100.0)
    return hits, float((hits.object_ids == 1).mean())


@pytest.mark.parametrize("kind", ["oak", "lime", "ash", "spruce"])
def test_leaves_let_part_of_the_rays_pass(kind: str) -> None:
    shares, coarse, winter, depth = [], [], [], []
    for seed in range(6):
        fine = grow(np.random.default_rng(seed), kind)
        hits, share = crown_hits(fine)
        shares.append(share)
        depth.append(np.ptp(hits.ranges[hits.object_ids == 1]))
        coarse.append(crown_hits(grow(np.random.default_rng(seed), kind, detail=0.2))[1])
        winter.append(crown_hits(fine, 0.0)[1])
    assert 0.25 < np.mean(shares) < 0.92
    assert np.mean(depth) > 1.5
    assert abs(np.mean(coarse) - np.mean(shares)) < 0.2
    if kind in EVERGREEN:
        assert winter == shares
    else:
        assert np.mean(winter) < 0.6 * np.mean(shares)


def test_solid_and_leaf_are_all_a_tree_is_made_of() -> None:
    empty = triangles([], 0.0)
    assert len(empty) == 0
    tree = grow(np.random.default_rng(0), "birch")
    assert set(np.unique(tree.material)) == {SOLID, LEAF}
