"""What changes between sessions, the industrial world, drives and named test sets."""

from __future__ import annotations

import pickle
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

pytest.importorskip("embreex", reason="the simulator needs segloc-lab")

from segloc_lab.simulation import (
    Conditions,
    hdl64e,
    industrial,
    simulate_sessions,
)
from segloc_lab.simulation.drives import mapped_way, way_back
from segloc_lab.simulation.objects.mesh import LEAF, SESSION_IDS, Objects
from segloc_lab.simulation.suites import SUMMER
from segloc_lab.simulation.worlds.interior import REPLACEABLE
from segloc_lab.simulation.worlds.roads import street_network
from segloc_lab.simulation.worlds.world import BUILT, World

pytestmark = pytest.mark.slow

SIZE = 150.0
LATER = Conditions(foliage=0.3, replaced=0.4, scaffolding=0.5)


@pytest.fixture(scope="module")
def works() -> World:
    return industrial(2, size_m=SIZE)


def bytes_of(objects: Objects) -> set[bytes]:
    return {triangle.tobytes() for triangle in objects.triangles}


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


def test_a_session_depends_on_world_number_and_conditions_alone(small: World) -> None:
    sensor = hdl64e(90)
    drive = simulate_sessions(small, sensor, [SUMMER, LATER], length_m=20.0)[1]
    points = drive.scan(4).points
    small.session(0)  # whatever was requested in between
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


def test_lasting_changes_grow_from_session_to_session(works: World) -> None:
    static = works.static.kinds.keys()
    gone: set[int] = set()
    stood: set[bytes] = set()
    for week, share in enumerate((0.1, 0.3, 0.5), start=1):
        stays, added = works.standing(
            week, Conditions(replaced=share, rebuilt=share, scaffolding=share, lasting=True)
        )
        assert gone < (gone := static - stays.kinds.keys())
        mine = {corners.tobytes() for corners in added.triangles}
        # What was put up for a thing that lasts is what it was; it may make way for later things.
        assert len(stood & mine) >= 0.9 * len(stood)
        stood = mine


def test_buildings_are_pulled_down_and_others_put_up(works: World) -> None:
    stays, added = works.standing(1, Conditions(rebuilt=1.0))
    assert not BUILT & set(stays.kinds.values())
    new = set(added.kinds.values())
    assert "hoarding" in new and new - {"hoarding"} <= BUILT
    for k, kind in added.kinds.items():
        if kind != "hoarding":  # within the plan of what stood there
            corners = added.triangles[added.object_ids == k].reshape(-1, 3)
            assert works.roads.clearance(corners[:, :2]).min() > -0.5


def test_snow_lies_beside_the_roads(works: World) -> None:
    at = np.stack(np.meshgrid(*[np.arange(20.0, SIZE - 20.0, 3.0)] * 2), -1).reshape(-1, 2)
    rays = np.column_stack([at, np.full(len(at), 100.0)]).astype(np.float32)
    down = np.tile(np.float32([0, 0, -1]), (len(at), 1))
    bare, snowy = (
        works.session(1, Conditions(snow=snow)).cast(rays, down, 200.0) for snow in (0.0, 0.4)
    )
    both = (bare.object_ids == 0) & (snowy.object_ids == 0)
    depth = (bare.ranges - snowy.ranges)[both]
    off = works.roads.clearance(at)[both]
    assert np.abs(depth[off < -1.0]).max() < 0.02
    assert 0.3 < np.median(depth[off > 2.0]) < 0.5


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
