"""What changes between sessions, the industrial world, drives and named test sets."""

from __future__ import annotations

import pickle
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the simulator needs the extra 'sim'")

from segloc_lab.simulation import (
    SCENES,
    Conditions,
    Scene,
    hdl64e,
    industrial,
    simulate_sessions,
    town,
)
from segloc_lab.simulation.drives import mapped_way, way_back
from segloc_lab.simulation.objects.mesh import LEAF, SESSION_IDS, Objects
from segloc_lab.simulation.objects.scene import Terrain
from segloc_lab.simulation.objects.vehicles import vehicle
from segloc_lab.simulation.suites import SIX, SUMMER
from segloc_lab.simulation.worlds.industrial import mesh_fence
from segloc_lab.simulation.worlds.interior import REPLACEABLE
from segloc_lab.simulation.worlds.roads import street_network
from segloc_lab.simulation.worlds.town import draw_character
from segloc_lab.simulation.worlds.world import BUILT, Extent, World, scaffold

from segloc.errors import ConfigError

pytestmark = pytest.mark.slow

SIZE = 150.0
LATER = Conditions(foliage=0.3, replaced=0.4, scaffolding=0.5)


@pytest.fixture(scope="module")
def small() -> World:
    return town(3, size_m=SIZE)


@pytest.fixture(scope="module")
def works() -> World:
    return industrial(2, size_m=SIZE)


def bytes_of(objects: Objects) -> set[bytes]:
    return {triangle.tobytes() for triangle in objects.triangles}


@pytest.mark.parametrize("name", ["foliage", "replaced", "scaffolding"])
@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan")])
def test_conditions_are_shares(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=rf"{name} must be in 0\.\.1"):
        Conditions(**{name: value})


def test_leaves_fall_in_a_fixed_order_and_nothing_else_does(small: World) -> None:
    static = small.static
    leaves = static.material == LEAF
    assert 0.2 < leaves.mean() < 0.95
    seen: set[bytes] = set()
    for share in (0.0, 0.5, 0.8, 1.0):
        now = static.with_foliage(share)
        left = int((now.material == LEAF).sum())
        assert left == pytest.approx(share * leaves.sum(), rel=0.02)
        assert len(now.triangles) - left == int((~leaves).sum())
        assert seen <= (seen := bytes_of(now))
        assert set(now.kinds) == set(np.unique(now.object_ids).tolist())


def test_trees_can_be_seen_through_in_winter(small: World) -> None:
    sensor = hdl64e(200).ideal()
    drives = [
        simulate_sessions(small, sensor, [Conditions(foliage=share)], length_m=30.0)[0]
        for share in (1.0, 0.0)
    ]
    on_trees = []
    for drive in drives:
        kinds = small.session(0, drive.conditions).kinds
        ids = np.concatenate([drive.object_ids(i) for i in range(0, len(drive), 3)])
        on_trees.append(sum(kinds[k] in ("tree", "bush", "shrubs") for k in ids.tolist()))
    assert on_trees[1] < 0.6 * on_trees[0]


def test_a_session_depends_on_world_number_and_conditions_alone(small: World) -> None:
    sensor = hdl64e(90)
    drive = simulate_sessions(small, sensor, [SUMMER, LATER], length_m=20.0)[1]
    points = drive.scan(4).points
    small.session(0)  # whatever was asked for in between
    elsewhere: Any = pickle.loads(pickle.dumps(drive))
    np.testing.assert_array_equal(elsewhere.scan(4).points, points)
    other = replace(drive, conditions=replace(LATER, replaced=0.0), _last=None)
    assert not np.array_equal(other.scan(4).points, points)


def test_things_are_replaced_near_by_and_on_free_ground(small: World) -> None:
    stays, added = small.standing(1, Conditions(replaced=0.4))
    before, after = small.static.kinds, stays.kinds
    gone = [before[k] for k in before.keys() - after.keys()]
    assert set(gone) <= REPLACEABLE.keys()
    bins = [k for k, kind in before.items() if kind in ("traffic sign", "bush")]
    assert sum(k not in after for k in bins) == pytest.approx(0.4 * len(bins), rel=0.35)
    assert 0.7 * len(gone) <= len(added.kinds) <= len(gone)
    assert set(added.kinds.values()) <= set(gone)
    assert SESSION_IDS < min(added.kinds) - SESSION_IDS < max(added.kinds) - SESSION_IDS
    assert max(added.kinds) < 3 * SESSION_IDS
    assert not added.kinds.keys() & small.changing(1).kinds.keys()
    for k in added.kinds:
        corner = added.triangles[added.object_ids == k].reshape(-1, 3)
        foot = corner[np.argmin(corner[:, 2])]
        assert abs(foot[2] - small.terrain.height(foot[0], foot[1])) < 1.2
        assert small.roads.clearance(corner[:, :2].mean(axis=0)) > 0
    again, _ = small.standing(1, Conditions(replaced=0.4))
    another, _ = small.standing(2, Conditions(replaced=0.4))
    assert again.kinds == stays.kinds != another.kinds


def test_scaffolding_stands_before_buildings(small: World) -> None:
    _, added = small.standing(1, Conditions(scaffolding=1.0))
    houses = [k for k, kind in small.static.kinds.items() if kind in BUILT]
    assert len(added.kinds) == len(houses) > 3
    for k, house in zip(sorted(added.kinds), houses, strict=True):
        tubes = added.triangles[added.object_ids == k].reshape(-1, 3)
        walls = small.static.triangles[small.static.object_ids == house].reshape(-1, 3)
        low, high = walls.min(axis=0), walls.max(axis=0)
        middle = tubes.mean(axis=0)
        assert (middle[:2] > low[:2] - 2.5).all() and (middle[:2] < high[:2] + 2.5).all()
        assert tubes[:, 2].max() < high[2] + 1.5
        assert tubes[:, 2].max() - tubes[:, 2].min() > 2.0


def test_scaffolding_keeps_to_the_wall_of_a_turned_house() -> None:
    rng = np.random.default_rng(4)
    turn = 0.5
    c, s = np.cos(turn), np.sin(turn)
    wall = np.array([[x, y, z] for x in (-5, 5) for y in (-3, 3) for z in (0, 6)]) @ np.array(
        [[c, s, 0], [-s, c, 0], [0, 0, 1]]
    )
    order = rng.integers(0, len(wall), (40, 3))
    flat = Terrain(np.array([-50.0, -50.0]), 100.0, np.zeros((2, 2)))
    mesh = scaffold(
        rng, Extent.of(wall[order].astype(np.float32)), flat, lambda xy: 20.0 - xy @ [-s, c]
    )
    across = mesh.triangles.reshape(-1, 3)[:, :2] @ [-s, c]
    assert across.min() > 3.2 and across.max() < 3.0 + 0.3 + 1.3 + 0.2


def test_industrial_estates_are_made_of_many_things_no_two_alike(works: World) -> None:
    kinds = set(works.static.kinds.values())
    assert kinds >= {"shipping container", "training house", "stair tower", "drums", "pallets"}
    assert len(kinds) > 15
    ids = works.static.object_ids
    shapes: dict[str, list[tuple[float, ...]]] = {}
    for k, kind in works.static.kinds.items():
        corner = works.static.triangles[
            np.searchsorted(ids, k) : np.searchsorted(ids, k, side="right")
        ].reshape(-1, 3)
        shapes.setdefault(kind, []).append(tuple(np.round(np.ptp(corner, axis=0), 4)))
    assert all(len(set(found)) == len(found) for found in shapes.values())
    industrial.cache_clear()
    again: World = pickle.loads(pickle.dumps(works))
    np.testing.assert_array_equal(again.static.triangles, works.static.triangles)
    assert industrial(5, size_m=SIZE).static.triangles.shape != again.static.triangles.shape


def test_nothing_stands_on_industrial_roads(works: World) -> None:
    line = np.concatenate([street.line for street in works.roads.streets])
    corner = works.static.triangles.reshape(-1, 3)
    height = corner[:, 2] - works.terrain.height(corner[:, 0], corner[:, 1])
    low = corner[(height < 2.0) & (height > 0.1)]
    for point in line[::4]:
        assert np.hypot(*(low[:, :2] - point).T).min() > 2.0


def test_most_rays_pass_a_mesh_fence() -> None:
    line = np.column_stack([np.full(9, 10.0), np.linspace(-8, 8, 9), np.full(9, -1.0)])
    fence = mesh_fence(np.random.default_rng(0), line)
    flat = Terrain(np.array([-40.0, -40.0]), 80.0, np.full((2, 2), -30.0))
    scene = Scene(flat, np.zeros(2, dtype=np.float32), [Objects.of([("fence", fence)], 1)])
    rng = np.random.default_rng(1)
    ways = np.column_stack(
        [np.full(4000, 10.0), rng.uniform(-7, 7, 4000), rng.uniform(-0.8, 0.5, 4000)]
    )
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    hits = scene.cast(np.zeros((4000, 3), np.float32), ways.astype(np.float32), 60.0)
    assert 0.1 < (hits.object_ids == 1).mean() < 0.5


def test_lorries_stand_where_there_is_room() -> None:
    rng = np.random.default_rng(0)
    long = [vehicle(rng, 10.4)[1][0] for _ in range(40)]
    short = [vehicle(rng, 5.3)[1][0] for _ in range(40)]
    assert max(short) <= 5.3
    assert 0.5 < np.mean(np.array(long) > 6.5) < 1.0
    assert max(long) <= 10.5


def test_towns_differ_in_character() -> None:
    drawn = [draw_character(np.random.default_rng(k)) for k in range(200)]
    assert {c.name for c in drawn} == {"suburb", "old town", "avenues", "mixed"}
    green = np.array([c.green for c in drawn])
    assert green.min() < 0.2 and green.max() > 0.9
    assert all(sum(c.buildings) == pytest.approx(1.0) for c in drawn)


def test_traffic_keeps_to_the_outer_lanes_of_wide_streets() -> None:
    seed = next(
        k
        for k in range(100)
        if draw_character(np.random.default_rng([k, 104729])).half_width[1] > 6.9
    )
    world = town(seed, size_m=SIZE)
    moving = world.spots.parking[world.spots.parking[:, 3] > 9]
    assert len(moving) > 3
    line = np.concatenate([street.line for street in world.roads.streets])
    gap = np.linalg.norm(moving[:, None, :2] - line[None], axis=2).min(axis=1)
    assert gap.min() > 3.5


@pytest.mark.parametrize("make", list(SCENES.values()), ids=list(SCENES))
def test_worlds_refuse_impossible_sizes_and_seeds(make: Any) -> None:
    with pytest.raises(ConfigError, match="size_m"):
        make(0, size_m=5.0)
    with pytest.raises(ConfigError, match="seed"):
        make(-1)


def test_later_sessions_come_back_both_ways_and_leave_the_map(works: World) -> None:
    rng = np.random.default_rng(7)
    world = replace(works, roads=street_network(rng, 400.0, margin_m=30.0, block_m=60.0))
    mapped = mapped_way(world, rng, 400.0)
    driven = set(pairwise(way_back(world, rng, mapped, 500.0)))
    forth, against = set(pairwise(mapped)), set(pairwise(mapped[::-1]))
    assert driven & forth
    assert driven & against
    assert driven - forth - against
    short = mapped_way(world, rng, 10.0)
    assert len(way_back(world, rng, short[:2], 30.0)) >= 2


def test_sessions_differ_in_lane_and_share_the_world(small: World) -> None:
    drives = simulate_sessions(small, hdl64e(30), [SUMMER, LATER, SUMMER], length_m=40.0)
    assert [drive.name for drive in drives] == ["session_0", "session_1", "session_2"]
    assert [drive.conditions for drive in drives] == [SUMMER, LATER, SUMMER]
    assert all(len(drive) == 20 for drive in drives)
    line = np.concatenate([street.line for street in small.roads.streets])
    offset = [
        np.median(np.linalg.norm(d.truth[:, None, :2, 3] - line[None], axis=2).min(axis=1))
        for d in drives
    ]
    assert len({round(float(value), 1) for value in offset}) == 3
    with pytest.raises(ConfigError, match="length_m"):
        simulate_sessions(small, hdl64e(30), [SUMMER], length_m=float("nan"))


def test_test_sets_are_maps_and_tests() -> None:
    names = [each.name for each in SIX]
    assert names == ["robotcar", "kitti", "fire_college", "george_square", "cornbury", "burgess"]
    tiny = replace(SIX[0], size_m={"small": SIZE}, share={"small": 0.001}, tests=(SUMMER, LATER))
    sessions = tiny.sessions("small")
    assert list(sessions) == ["map", "test_0", "test_1"]
    assert all(len(session) in (2, 3) for session in sessions.values())
    swathe = sessions["test_1"].scan(0)
    assert len(swathe.points) > 10_000
    assert np.ptp(swathe.points[:, 0]) > 20.0
    training = tiny.training(1)
    assert len(training) == 2
    with pytest.raises(ConfigError, match="scale must be one of small, not 'huge'"):
        tiny.sessions("huge")
