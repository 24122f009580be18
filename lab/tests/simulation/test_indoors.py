"""Halls, offices, storeys and mines: repeatable, closed, passable, and as regular as they say."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

pytest.importorskip("embreex", reason="the simulator needs segloc-lab")

from segloc_lab.simulation import SCENES, Conditions, Route, Scene, World, building, offices
from segloc_lab.simulation.drives import lane
from segloc_lab.simulation.plans import plan_of
from segloc_lab.simulation.worlds.mine import skin

from segloc.types import Float64

pytestmark = pytest.mark.slow

SIZES = {"warehouse": 60.0, "offices": 40.0, "building": 40.0, "mine": 70.0}


@pytest.fixture(scope="module", params=sorted(SIZES))
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def world(kind: str) -> World:
    return SCENES[kind](5, size_m=SIZES[kind])


def of_kind(world: World, kind: str) -> list[Float64]:
    """The corners (n, 3) of each static object of a kind."""
    static = world.static
    numbers = [k for k, name in static.kinds.items() if name == kind]
    return [static.triangles[static.object_ids == k].reshape(-1, 3).astype(float) for k in numbers]


# --- worlds ---------------------------------------------------------------------------------------


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


def test_two_half_plans_are_a_plan() -> None:
    world = offices(3, size_m=40.0)
    plan, inside = plan_of(world), world.interior
    assert inside is not None
    ends = [np.append(inside.to_world([x, 5.0]), 1.0) for x in (0.0, inside.size[0])]
    direction = (ends[1] - ends[0])[:2] / inside.size[0]

    def area(triangles: Float64) -> float:
        a, b, c = triangles.transpose(1, 0, 2)
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)

    halves = [plan.half(direction), plan.half(-direction)]
    assert sum(area(half.triangles) for half in halves) == pytest.approx(area(plan.triangles))
    along = halves[0].triangles.reshape(-1, 3)[:, :2] @ direction
    assert np.ptp(along) < inside.size[0] / 2 + 1.5
    assert "desk" not in {kind for kind, _ in plan.elements}
