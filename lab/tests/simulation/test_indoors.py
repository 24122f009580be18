"""Halls, offices, storeys and mines: repeatable, closed, passable, and as regular as they say."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

pytest.importorskip("embreex", reason="simulation needs the extra sim")

from segloc_lab.simulation import (
    Conditions,
    Route,
    Scene,
    World,
    building,
    mine,
    offices,
    os1_64,
    simulate_sessions,
    vlp16,
    warehouse,
    wheeled,
)
from segloc_lab.simulation.drives import lane
from segloc_lab.simulation.objects.mesh import SESSION_IDS
from segloc_lab.simulation.worlds.interior import Interior
from segloc_lab.simulation.worlds.mine import skin

from segloc import Config, Localizer, build_map
from segloc.errors import ConfigError
from segloc.types import Float64

pytestmark = pytest.mark.slow

SIZES = {"warehouse": 60.0, "offices": 40.0, "building": 40.0, "mine": 70.0}
MAKERS: dict[str, Callable[..., World]] = {
    "warehouse": warehouse,
    "offices": offices,
    "building": building,
    "mine": mine,
}
EXPECTED = {
    "warehouse": {"wall", "ceiling", "pillar", "beams", "goods", "lamps"},
    "offices": {"wall", "ceiling", "desk", "cupboard", "lamps"},
    "building": {"wall", "ceiling", "floor", "stairs", "desk"},
    "mine": {"rock", "stores"},
}


@pytest.fixture(scope="module", params=sorted(MAKERS))
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def world(kind: str) -> World:
    return MAKERS[kind](5, size_m=SIZES[kind])


def of_kind(world: World, kind: str) -> list[Float64]:
    """The corners (n, 3) of each static object of a kind."""
    static = world.static
    numbers = [k for k, name in static.kinds.items() if name == kind]
    return [static.triangles[static.object_ids == k].reshape(-1, 3).astype(float) for k in numbers]


# --- worlds ---------------------------------------------------------------------------------------


def test_a_world_is_a_function_of_its_seed(kind: str, world: World) -> None:
    again = MAKERS[kind].__wrapped__(5, size_m=SIZES[kind])  # type: ignore[attr-defined]
    for name in ("triangles", "reflectance", "material", "object_ids"):
        np.testing.assert_array_equal(getattr(again.static, name), getattr(world.static, name))
    np.testing.assert_array_equal(again.spots.movables, world.spots.movables)
    other = MAKERS[kind](6, size_m=SIZES[kind])
    assert other.static.triangles.shape != world.static.triangles.shape
    data = pickle.dumps(world)
    assert len(data) < 500
    copy = pickle.loads(data)
    assert copy.static.kinds == world.static.kinds
    assert copy.interior == world.interior


def test_objects_are_sound(kind: str, world: World) -> None:
    static = world.static
    assert np.isfinite(static.triangles).all()
    assert EXPECTED[kind] <= set(static.kinds.values())
    assert max(static.kinds) < SESSION_IDS
    assert ((static.reflectance > 0) & (static.reflectance <= 1)).all()


def test_there_are_walls_all_around_and_a_roof_above_every_way(world: World) -> None:
    scene = Scene(world.terrain, world.ground_reflectance, [world.static])
    angle = np.linspace(0, 2 * np.pi, 36, endpoint=False)
    around = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    ways = np.concatenate([around, [[0.0, 0.0, 1.0]]]).astype(np.float32)
    reach = lane(world, 0)
    for storey in range(1 if world.interior is None else len(world.interior.storeys)):
        route = world.roads.walk(np.random.default_rng(1), [0], 150.0, avoid=[])
        for side in (-reach, reach):
            poses = Route(tuple(route), side, 1.0, storey=storey).poses(world, 1.2)
            above = poses[:, 2, 3] - world.floor(storey).heights.mean()
            if world.interior is not None:
                np.testing.assert_allclose(above, 1.2, atol=0.1)
            origins = np.repeat(poses[:, :3, 3], 37, axis=0).astype(np.float32)
            hits = scene.cast(origins, np.tile(ways, (len(poses), 1)), 500.0)
            ranges = hits.ranges.reshape(-1, 37)
            assert np.isfinite(ranges).mean() > 0.97  # but for dock doors that are up
            assert ranges[:, :36].min() > 0.25
            assert (ranges[:, 36] > 0.3).all() and (ranges[:, 36] < 15.0).all()


def test_goods_and_furniture_are_replaced_inside_on_their_storey(kind: str, world: World) -> None:
    if kind == "mine":
        pytest.skip("what is left in niches is too little to count")
    inside = world.interior
    assert inside is not None
    stays, added = world.standing(1, Conditions(replaced=0.3))
    gone = [world.static.kinds[k] for k in world.static.kinds.keys() - stays.kinds.keys()]
    usual = {"warehouse": "goods", "offices": "desk", "building": "desk"}[kind]
    assert gone.count(usual) == pytest.approx(0.3 * len(of_kind(world, usual)), rel=0.45)
    assert 0.8 * len(gone) <= len(added.kinds) <= len(gone)
    standing = {inside.storey(corners[:, 2].min()) for corners in of_kind(world, usual)}
    assert standing == set(range(len(inside.storeys)))
    for k in added.kinds:
        corners = added.triangles[added.object_ids == k].reshape(-1, 3)
        assert inside.inside(corners[:, :2].mean(axis=0)) or added.kinds[k] != "plant"
        storey = inside.storey(float(corners[:, 2].min()))
        base = float(corners[:, 2].min()) - inside.storeys[storey]
        assert -0.4 < base < (0.4 if kind != "warehouse" else 12.0)
    again, _ = world.standing(1, Conditions(replaced=0.3))
    assert again.kinds == stays.kinds


def test_doors_chairs_and_trolleys_are_elsewhere_in_each_session(world: World) -> None:
    first, same, later = world.changing(1), world.changing(1), world.changing(2)
    np.testing.assert_array_equal(first.triangles, same.triangles)
    assert first.triangles.shape != later.triangles.shape or not np.array_equal(
        first.triangles, later.triangles
    )


@pytest.mark.parametrize(
    "make",
    [
        lambda: warehouse(0, size_m=1000.0),
        lambda: building(0, storeys=0),
        lambda: building(0, storeys=21),
        lambda: building(0, differ=1.5),
        lambda: building(0, differ=float("nan")),
        lambda: building(5, size_m=40.0).floor(5),
        lambda: warehouse(5, size_m=60.0).floor(-1),
        lambda: simulate_sessions(
            offices(5, size_m=40.0), vlp16(30), [Conditions()], length_m=20.0, storey=1
        ),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(make: Callable[[], object]) -> None:
    with pytest.raises(ConfigError) as caught:
        make()
    assert "\n" not in str(caught.value)


# --- halls ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2, 7])
def test_pillars_repeat_on_a_lattice(seed: int) -> None:
    hall = warehouse(seed, size_m=70.0, repetitive=True)
    assert hall.interior is not None
    feet = np.array([corners[:, :2].mean(axis=0) for corners in of_kind(hall, "pillar")])
    plan = hall.interior.to_plan(feet)
    assert len(plan) >= 12
    across = np.unique(np.round(plan[:, 1], 3))
    pitch = np.diff(across)
    np.testing.assert_allclose(pitch, pitch[0], atol=2e-3)
    assert 4.0 <= pitch[0] <= 8.0
    for y in across:
        row = np.sort(plan[np.abs(plan[:, 1] - y) < 0.01, 0])
        step = np.diff(row)
        assert (step > 3.99).all() and (step < 16.01).all()  # two halls may meet in between
        assert 4.0 <= np.median(step) <= 8.0
        assert (np.abs(step - np.median(step)) < 1e-3).mean() > 0.5


def test_a_bare_hall_looks_alike_a_period_on_and_one_with_racks_does_not() -> None:
    """A ring of rays at 1 m, from two places a period apart, in the middle of a hall."""

    def unlike(hall: World, step: float, at: Float64) -> float:
        scene = Scene(hall.terrain, hall.ground_reflectance, [hall.static])
        assert hall.interior is not None
        angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
        ways = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]).astype(np.float32)
        found = []
        for shift in (0.0, step):
            start = np.append(hall.interior.to_world(at + [shift, 0.0]), 1.0)
            found.append(scene.cast(np.tile(start, (720, 1)).astype(np.float32), ways, 11.0).ranges)
        here, there = (np.minimum(ranges, 11.0) for ranges in found)
        return float((np.abs(here - there) > 0.02).mean())

    def middle(hall: World) -> tuple[float, Float64]:
        assert hall.interior is not None
        feet = [corners[:, :2].mean(axis=0) for corners in of_kind(hall, "pillar")]
        plan = hall.interior.to_plan(np.array(feet))
        x, y = np.unique(np.round(plan[:, 0], 2)), np.unique(np.round(plan[:, 1], 2))
        k = len(x) // 2
        return float(x[k] - x[k - 1]), np.array([x[k - 1], (y[1] + y[2]) / 2]) + [1.0, 0.3]

    bare = warehouse(7, size_m=60.0, repetitive=True)
    full = warehouse(3, size_m=60.0, repetitive=False)
    assert unlike(bare, *middle(bare)) < 0.12
    assert unlike(full, *middle(full)) > 0.25


# --- storeys --------------------------------------------------------------------------------------


def furniture(house: World, storey: int) -> Float64:
    """Middles and sizes of the furniture of a storey, its floor at 0; rows sorted."""
    assert house.interior is not None
    rows = [
        np.concatenate([corners.min(axis=0), corners.max(axis=0)])
        for kind in ("desk", "cupboard", "shelf", "table", "lockers")
        for corners in of_kind(house, kind)
        if house.interior.storey(corners[:, 2].min()) == storey
    ]
    array = np.array(rows) - [0, 0, house.interior.storeys[storey]] * 2
    return array[np.lexsort(array.T)]


def test_storeys_have_one_plan_and_furniture_as_they_should() -> None:
    equal, apart = (building(4, size_m=40.0, storeys=3, differ=d) for d in (0.0, 1.0))
    for house in (equal, apart):
        walls = np.concatenate(of_kind(house, "wall"))
        assert house.interior is not None
        rise = house.interior.storeys[1]
        assert 2.9 < rise < 4.0
        storey = np.floor((walls[:, 2] + 0.31) / rise).clip(0, 2)
        plans = [np.unique(np.round(walls[storey == k, :2], 2), axis=0) for k in range(3)]
        np.testing.assert_array_equal(plans[0], plans[1])
        np.testing.assert_array_equal(plans[0], plans[2])
    np.testing.assert_allclose(furniture(equal, 0), furniture(equal, 2), atol=1e-3)
    first, second = furniture(apart, 0), furniture(apart, 2)
    assert len(first) > 20
    gap, _ = cKDTree(first).query(second)
    assert (gap < 0.01).mean() < 0.1
    np.testing.assert_array_equal(
        np.concatenate(of_kind(equal, "wall")), np.concatenate(of_kind(apart, "wall"))
    )


def walls(house: World, storey: int) -> Float64:
    """(N, 2) corners of the walls of a storey, seen from above."""
    assert house.interior is not None
    corners = np.concatenate(of_kind(house, "wall"))
    on = np.floor((corners[:, 2] + 0.31) / house.interior.storeys[1]) == storey
    return np.unique(np.round(corners[on, :2], 2), axis=0)


def test_storeys_may_have_rooms_of_their_own() -> None:
    alike, house = (building(4, size_m=40.0, storeys=3, own_rooms=own) for own in (False, True))
    np.testing.assert_array_equal(walls(house, 0), walls(alike, 0))
    outer = walls(alike, 0)
    low, high = outer.min(axis=0), outer.max(axis=0)
    for storey in (1, 2):
        own = walls(house, storey)
        np.testing.assert_allclose([own.min(axis=0), own.max(axis=0)], [low, high], atol=0.02)
        gap, _ = cKDTree(outer).query(own)
        assert 0.1 < (gap > 0.3).mean() < 0.9
    assert house.recipe is not None
    make, arguments = house.recipe
    np.testing.assert_array_equal(make(*arguments).static.triangles, house.static.triangles)


def test_a_path_on_each_storey_is_the_same_but_for_its_height() -> None:
    house = building(4, size_m=40.0, storeys=3)
    assert house.interior is not None
    drives = [
        simulate_sessions(
            house, vlp16(60), [Conditions()], length_m=40.0, platform=wheeled(), storey=k
        )[0]
        for k in range(3)
    ]
    for k, drive in enumerate(drives):
        rise = [0.0, 0.0, house.interior.storeys[k]]
        np.testing.assert_allclose(
            drive.truth[:, :3, 3] - rise, drives[0].truth[:, :3, 3], atol=1e-9
        )
        points = drive.scan(5).points @ drive.truth[5, :3, :3].T + drive.truth[5, :3, 3]
        inner = points[:, 2] - house.interior.storeys[k]
        assert ((inner > -0.2) & (inner < 3.5)).mean() > 0.9


def test_stairs_lead_through_the_floors() -> None:
    house = building(4, size_m=40.0, storeys=3)
    inside = house.interior
    assert inside is not None
    scene = Scene(house.terrain, house.ground_reflectance, [house.static])
    wide = np.stack(
        np.meshgrid(np.linspace(0.4, 39.6, 300), np.linspace(0.4, inside.size[1] - 0.4, 200)), -1
    )
    plan = wide.reshape(-1, 2)
    top = inside.storeys[2] + 1.0
    origins = np.column_stack([inside.to_world(plan), np.full(len(plan), top)]).astype(np.float32)
    down = np.tile(np.array([0.0, 0.0, -1.0], dtype=np.float32), (len(plan), 1))
    hits = scene.cast(origins, down, 50.0)
    deep = plan[hits.ranges > 1.5]
    assert len(deep) > 50
    assert ((deep[:, 0] < 3.5) | (deep[:, 0] > 36.5)).all()
    assert (deep[:, 0] < 3.5).any() and (deep[:, 0] > 36.5).any()


def test_an_interior_turns_there_and_back() -> None:
    inside = Interior((30.0, 12.0), 0.7, (5.0, -3.0), (0.0, 3.0))
    points = np.random.default_rng(0).uniform(0, 12, (20, 2))
    np.testing.assert_allclose(inside.to_plan(inside.to_world(points)), points, atol=1e-12)
    assert inside.inside(inside.to_world([[15.0, 6.0], [29.5, 6.0], [15.0, 13.0]])).tolist() == [
        True,
        False,
        False,
    ]
    assert [inside.storey(z) for z in (-0.3, 0.0, 2.5, 2.7, 9.0)] == [0, 0, 0, 1, 1]


# --- mines ----------------------------------------------------------------------------------------


def test_the_skin_of_a_ball_is_a_closed_sphere() -> None:
    axis = np.arange(-2.0, 2.01, 0.25)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    field = (np.sqrt(x**2 + y**2 + z**2) - 1.3).astype(np.float32)
    corner = skin(field, np.full(3, -2.0), 0.25).triangles
    radius = np.linalg.norm(corner, axis=2)
    assert np.abs(radius - 1.3).max() < 0.05
    edges = np.sort(
        np.unique(np.round(corner.reshape(-1, 3), 9), axis=0, return_inverse=True)[1]
        .reshape(-1, 3)[:, [[0, 1], [1, 2], [2, 0]]]
        .reshape(-1, 2),
        axis=1,
    )
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count == 2).all()  # every edge joins two triangles: no holes


def test_galleries_are_rough_in_some_stretches_and_smooth_in_others() -> None:
    """How far rays that look up meet the roof, along a way: its spread, stretch by stretch."""
    pit = mine(5, size_m=110.0)
    scene = Scene(pit.terrain, pit.ground_reflectance, [pit.static])
    spread = []
    for street in pit.roads.streets:
        at, _ = street.at(np.arange(5.0, street.length - 5.0, 0.2))
        for part in np.array_split(at, max(1, len(at) // 40)):
            height = pit.terrain.height(*part.T) + 1.0
            origins = np.column_stack([part, height]).astype(np.float32)
            up = np.tile(np.array([0.0, 0.0, 1.0], dtype=np.float32), (len(part), 1))
            hits = scene.cast(origins, up, 20.0)
            rock = np.array([pit.static.kinds.get(int(k)) == "rock" for k in hits.object_ids])
            if rock.sum() > 15:
                spread.append(float(np.diff(hits.ranges[rock], n=2).std()))
    assert len(spread) > 10
    assert np.quantile(spread, 0.9) > 2.5 * np.quantile(spread, 0.1)


# --- what segloc makes of them --------------------------------------------------------------------


def test_a_query_in_the_warehouse_is_localized_in_a_map_of_the_same_hall() -> None:
    """Goods have been replaced since, and the robot comes back along other lanes."""
    hall = warehouse(3, size_m=60.0, repetitive=False)
    config = Config.preset("geo")
    drives = simulate_sessions(
        hall, os1_64(512), [Conditions(), Conditions(replaced=0.1)], length_m=80.0,
        spacing_m=1.5, seed=1, platform=wheeled(),
    )  # fmt: skip
    localizer = Localizer(build_map(drives[0], config), config)
    mapped, driven = (drive.truth[:, :2, 3] for drive in drives)
    near = np.flatnonzero(cKDTree(mapped).query(driven)[0] < 2.0)[::3]
    answers = [(k, localizer.localize(drives[1].scan(int(k)).points)) for k in near]
    found = [(k, answer) for k, answer in answers if answer.localized]
    assert len(found) > 0.3 * len(answers) > 3
    for k, answer in found:
        assert answer.T_map_sensor is not None
        error = np.linalg.inv(drives[1].truth[k]) @ answer.T_map_sensor
        assert np.linalg.norm(error[:3, 3]) < 0.5
        assert np.degrees(Rotation.from_matrix(error[:3, :3]).magnitude()) < 3.0
