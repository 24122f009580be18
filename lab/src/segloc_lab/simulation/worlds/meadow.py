"""A meadow: rough open ground with mounds, scattered shrubs and trees, hedgerows, few landmarks."""

from __future__ import annotations

from functools import partial

import numpy as np

from segloc.types import Float64

from ..objects.fixtures import bale, bench, gate, name_sign, picnic_table, post_row, trough
from ..objects.vegetation import boulder, brushwood, grass, grow, log, shrubs, stump
from .land import Ground, Land, Options, grow_thicket, lay_out, scattered
from .layout import check_world
from .roads import street_network
from .world import World, remember

_SEEN = 45.0  # from a path: shrubs farther away are left out


@remember
def meadow(seed: int, *, size_m: float = 340.0) -> World:
    """A meadow of about ``size_m`` metres square; the same for the same seed."""
    check_world(seed, size_m, 100.0, 1000.0)
    rng = np.random.default_rng([seed, 32_452_843])
    paths = street_network(
        rng,
        size_m,
        margin_m=32.0,
        block_m=float(rng.uniform(75, 100)),
        half_width=(1.9, 2.4),
        shift=0.28,
        bend=0.22,
    )
    ground = Ground(
        slope=rng.uniform(0.025, 0.05), humps=rng.uniform(0.04, 0.09), rough=0.05, ditches=0.3
    )
    land = lay_out(rng, paths, size_m, ground)
    _hedgerows(land)
    _by_the_paths(land)
    for middle in scattered(rng, size_m, float(rng.uniform(38, 55)), 0.5):
        _group(land, middle)
    for at in scattered(rng, size_m, float(rng.uniform(11, 16)), 0.6):
        if land.distance(at) < _SEEN:
            _single(land, at)
    for at in scattered(rng, size_m, 4.0, 0.6):
        if land.distance(at) < 14.0 and rng.random() < 0.5:
            land.grow("grass", grass, at, 0.4)
    return land.world("meadow", seed)


def _tree(land: Land, species: str, at: Float64, scale: float) -> None:
    make = partial(grow, kind=species, detail=land.detail(at), scale=scale)
    land.grow("tree", make, at, 1.5)


def _group(land: Land, middle: Float64) -> None:
    """A copse, a shrub thicket, or nothing."""
    rng, pick, wide = land.rng, land.rng.random(), land.rng.uniform(4, 13)
    spots = middle + rng.normal(0, 0.5 * wide, (int(0.25 * wide**1.5) + 2, 2))
    if pick < 0.35:
        mix = rng.choice(["oak", "ash", "birch", "willow", "lime"], 2, replace=False)
        for at in spots:
            _tree(land, str(rng.choice(mix)), at, float(rng.uniform(0.6, 1.0)))
    elif pick < 0.75:
        for at in np.concatenate([spots, middle + rng.normal(0, 0.5 * wide, spots.shape)]):
            _shrub(land, at)
    elif pick < 0.85:
        for at in spots:
            _tree(land, "birch", at, float(rng.uniform(0.4, 0.8)))


def _shrub(land: Land, at: Float64) -> None:
    rng, bush, pick = land.rng, partial(grow, detail=land.detail(at)), land.rng.random()
    if pick < 0.45:
        scale = float(rng.uniform(0.5, 1.1))
        land.grow("bush", partial(bush, kind="hawthorn", scale=scale), at, 1.4)
    elif pick < 0.6:
        land.grow("bush", partial(bush, kind="hazel", scale=0.8), at, 1.4)
    else:
        grow_thicket(land, at, [0.5, 0.6], [2.4, 2.3])


_SMALL: Options = (
    (0.64, "sapling", partial(grow, kind="sapling"), 0.6),
    (0.76, "boulder", boulder, 1.2),
    (0.80, "stump", stump, 1.0),
    (0.87, "brushwood", brushwood, 1.5),
)


def _single(land: Land, at: Float64) -> None:
    rng, pick = land.rng, land.rng.random()
    if pick < 0.42:
        _shrub(land, at)
    elif pick < 0.54:
        kind = rng.choice(["oak", "ash", "willow", "birch", "pine", "lime"])
        _tree(land, str(kind), at, float(rng.uniform(0.5, 1.0)))
    elif 0.64 <= pick < 0.69:
        _tree(land, "snag", at, 0.7)
    elif 0.80 <= pick < 0.84:
        turn = rng.uniform(0, 2 * np.pi)
        way = np.array([np.cos(turn), np.sin(turn)]) * rng.uniform(2, 7)
        points = land.line(at + np.linspace(0, 1, 8)[:, None] * way)
        if len(points) > 3:
            land.put("log", log(rng, land.ground_line(points)))
    else:
        land.grow_one(_SMALL, pick, at)


def _hedgerows(land: Land) -> None:
    """Old field boundaries: hawthorns with gaps, here and there a tree, or a row of posts."""
    rng, size_m = land.rng, land.ground.size_m
    for _ in range(max(2, int((size_m / 75) ** 2))):
        start, turn = rng.uniform(10, size_m - 10, 2), rng.uniform(0, 2 * np.pi)
        s = np.arange(0.0, rng.uniform(20, 70), 1.6)
        angle = turn + np.cumsum(rng.normal(0, 0.04, len(s)))
        way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        points = land.line(start + np.cumsum(1.6 * way, axis=0))
        if len(points) < 5:
            continue
        pick = rng.random()
        if pick < 0.35:
            land.put("fence", post_row(rng, land.ground_line(points[::2])))
        elif pick < 0.55:
            for piece in np.array_split(points, max(1, len(points) // 12)):
                row = land.ground_line(piece[:-1] if len(piece) > 4 else piece)
                land.put("shrubs", shrubs(rng, row))
        else:
            for at in points[rng.random(len(points)) < 0.7] + rng.normal(0, 0.3, 2):
                if rng.random() < 0.88:
                    _shrub(land, at)
                else:
                    _tree(land, str(rng.choice(["oak", "ash"])), at, 0.8)


_BY_PATHS: Options = (
    (0.2, "bench", bench, 1.6),
    (0.3, "name sign", name_sign, 1.0),
    (0.4, "gate", gate, 2.0),
    (0.48, "bale", bale, 2.0),
    (0.55, "trough", trough, 1.6),
    (0.61, "picnic table", picnic_table, 2.2),
)


def _by_the_paths(land: Land) -> None:
    """Gates, benches, signs, a trough; somebody walking."""
    rng = land.rng
    for street in land.roads.streets:
        for s in rng.uniform(6, max(7.0, street.length - 6), 1 + int(street.length / 28)):
            side, pick = float(rng.choice([-1, 1])), rng.random()
            at, yaw = street.at(s, side * (street.half_width + rng.uniform(2.0, 6.0)))
            facing = float(yaw) - side * np.pi / 2 + float(rng.normal(0, 0.15))
            land.grow_one(_BY_PATHS, pick, at, facing)
        walkers = rng.uniform(5, max(6.0, street.length - 5), int(street.length / 25))
        land.walkers(street.at(walkers, street.half_width + 1.4)[0])
