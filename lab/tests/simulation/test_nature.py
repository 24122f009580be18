"""Parks, meadows and forests: repeatable, consistent, passable, and seen as nature is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("embreex", reason="the simulator needs segloc-lab")

from segloc_lab.simulation import SCENES, Conditions, Route, Scene, World
from segloc_lab.simulation.objects.mesh import LEAF, Mesh, Objects
from segloc_lab.simulation.objects.scene import Hits, Terrain
from segloc_lab.simulation.objects.vegetation import EVERGREEN, SPECIES, grow

pytestmark = pytest.mark.slow

SIZES = {"park": 150.0, "meadow": 120.0, "forest": 100.0}


@pytest.fixture(scope="module", params=sorted(SIZES))
def world(request: pytest.FixtureRequest) -> World:
    return SCENES[request.param](5, size_m=SIZES[request.param])


# --- worlds ---------------------------------------------------------------------------------------


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


# --- trees ----------------------------------------------------------------------------------------


@given(
    kind=st.sampled_from(sorted(SPECIES)),
    seed=st.integers(0, 10_000),
    detail=st.floats(0.1, 1.0),
    scale=st.floats(0.4, 1.2),
)
@settings(max_examples=15, deadline=None)
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


@pytest.mark.parametrize("kind", ["oak", "spruce"])
def test_leaves_let_part_of_the_rays_pass(kind: str) -> None:
    shares, coarse, winter, depth = [], [], [], []
    for seed in range(3):
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
