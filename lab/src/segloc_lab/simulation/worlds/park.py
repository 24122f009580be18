"""A park in a square of houses: lawns and paths, old trees, beds, railings, a playground."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from segloc.types import Float64

from ..objects import fixtures, vegetation
from .land import Ground, Land, Maker, Options, lay_out, scattered
from .layout import Frontage, check_world
from .lots import build_along, dress
from .roads import RoadNetwork, Street, street_network
from .world import World, remember

_MARGIN = 36.0
_TREES = ("lime", "oak", "beech", "ash", "willow", "birch", "pine", "yew")
_TREE_SHARES = np.array([0.26, 0.17, 0.14, 0.14, 0.06, 0.1, 0.05, 0.08])


@remember
def park(seed: int, *, size_m: float = 240.0) -> World:
    """A park of about ``size_m`` metres square with the houses about it; a function of the seed."""
    check_world(seed, size_m, 150.0, 600.0)
    rng = np.random.default_rng([seed, 49_979_687])
    roads = _network(rng, size_m)
    ground = Ground(
        slope=rng.uniform(0.015, 0.035), humps=rng.uniform(0.015, 0.035), rough=0.022, kerb=0.1
    )
    land = lay_out(rng, roads, size_m, ground)
    ring = [s for s in roads.streets if s.half_width > 3]
    for street in ring:
        side = _outward(street, size_m)
        character = str(rng.choice(["villas", "terrace", "flats", "mixed"]))
        front = Frontage(street, side, float(rng.uniform(1.6, 2.8)), character)
        for lot in build_along(land, front):
            dress(land, lot)
        _street(land, front)
        _border(land, Frontage(street, -side, 1.8, "green"))
    for street in roads.streets:
        if street.half_width < 3:
            _path(land, street)
    _features(land)
    _lawns(land)
    return land.world("park", seed)


def _network(rng: np.random.Generator, size_m: float) -> RoadNetwork:
    """Paths inside a ring of streets."""
    net = street_network(
        rng,
        size_m,
        margin_m=_MARGIN,
        block_m=float(rng.uniform(38, 52)),
        half_width=(1.9, 2.4),
        shift=0.16,
        bend=0.16,
        missing=0.0,
    )
    side = int(np.sqrt(len(net.nodes)))
    row, column = np.divmod(np.arange(len(net.nodes)), side)
    outer = (row % (side - 1) == 0) | (column % (side - 1) == 0)
    wide = float(rng.uniform(4.0, 4.8))
    streets = []
    for street in net.streets:
        a, b = street.nodes
        same = row[a] == row[b] and row[a] % (side - 1) == 0
        same |= column[a] == column[b] and column[a] % (side - 1) == 0
        if same:
            streets.append(replace(street, half_width=wide))
        elif not (outer[a] or outer[b]) or rng.random() < 0.75:
            streets.append(street)
    return RoadNetwork(net.nodes, tuple(streets))


def _outward(street: Street, size_m: float) -> int:
    """The side of a ring street that looks away from the park."""
    middle = street.length / 2
    left, _ = street.at(middle, 5.0)
    right, _ = street.at(middle, -5.0)
    away = np.abs(left - size_m / 2).max() > np.abs(right - size_m / 2).max()
    return 1 if away else -1


_Kinds: TypeAlias = tuple[tuple[str, Maker], ...]
_ON_PAVEMENTS: _Kinds = (
    ("traffic sign", fixtures.traffic_sign),
    ("cabinet", fixtures.cabinet),
    ("bollards", fixtures.bollards),
    ("litter bin", fixtures.litter_bin),
)
_ORNAMENTS: _Kinds = (
    ("statue", fixtures.statue),
    ("statue", fixtures.statue),
    ("fountain", fixtures.fountain),
)
_PLAYGROUND: _Kinds = (
    ("swings", fixtures.swings),
    ("slide", fixtures.slide),
    ("climbing frame", fixtures.climbing_frame),
    ("picnic table", fixtures.picnic_table),
)


def _street(land: Land, front: Frontage) -> None:
    """The pavement before the houses, and cars on both sides of the street."""
    rng, street = land.rng, front.street
    for s in np.arange(rng.uniform(6, 20), street.length - 6, rng.uniform(22, 34)):
        at, yaw = front.at(s, 0.6)
        land.stand("lamp", fixtures.lamp(rng), at, float(yaw) - np.pi / 2, 0.4)
    for s in rng.uniform(6, street.length - 6, int(street.length / 14)):
        at, yaw = front.at(s, rng.uniform(0.4, 0.8))
        kind, make = _pick(rng, _ON_PAVEMENTS)
        land.stand(kind, make(rng), at, float(yaw) - np.pi / 2, 0.6)
    busy = rng.uniform(0.5, 0.95)
    for side in (front.side, -front.side):
        lane = Frontage(street, side, 2.0, "green")
        for s in np.arange(10.0, street.length - 10.0, rng.uniform(5.6, 6.6)):
            at, yaw = lane.at(s, -0.3)
            ends, _ = lane.at(np.array([s - 3.0, s + 3.0]), -0.3)
            away = np.linalg.norm(land.roads.nodes - at, axis=1).min()
            clear = land.roads.clearance(ends).min() > -0.6 and away > 9.0
            if clear and land.ground.free(at, (5.2, 1.9), float(yaw)):
                land.parking.append((*at, float(yaw), 5.3, busy))
    walkers = rng.uniform(3, street.length - 3, int(street.length / 8))
    land.walkers(front.at(walkers, rng.uniform(0.9, front.pavement, len(walkers)))[0])


def _pick(rng: np.random.Generator, options: _Kinds) -> tuple[str, Maker]:
    return options[int(rng.integers(len(options)))]


def _border(land: Land, front: Frontage) -> None:
    """Where the park meets the street: railings, a hedge or shrubs, trees behind."""
    rng, street = land.rng, front.street
    s = np.arange(1.5, street.length - 1.5, 1.5)
    edge = land.line(front.at(s, front.pavement)[0])
    pick = rng.random()
    if len(edge) > 3:
        line = land.ground_line(edge)
        if pick < 0.5:
            land.put("railing", fixtures.fence(rng, line))
        elif pick < 0.75:
            land.put("hedge", vegetation.hedge(rng, line, *rng.uniform([0.8, 0.5], [1.9, 1.0])))
        for point in edge:
            land.ground.claim(point, (0.8, 0.8), 0.0)
    behind = land.line(front.at(s, front.pavement + rng.uniform(2.0, 3.5))[0])
    for piece in np.array_split(behind, max(1, len(behind) // 7)):
        if len(piece) > 2 and rng.random() < 0.5:
            land.put("shrubs", vegetation.shrubs(rng, land.ground_line(piece)))
            for point in piece:
                land.ground.claim(point, (1.2, 1.2), 0.0)
    for at in front.at(s[::6] + rng.normal(0, 1.0, len(s[::6])), front.pavement + 5.0)[0]:
        if rng.random() < 0.6:
            _tree(land, at)


def _tree(land: Land, at: Float64, kind: str | None = None, scale: float = 1.0) -> None:
    species = kind or str(land.rng.choice(_TREES, p=_TREE_SHARES / _TREE_SHARES.sum()))
    land.grow("tree", partial(vegetation.grow, kind=species, scale=scale), at, 1.6)


_BY_PATHS: Options = (
    (0.4, "bench", fixtures.bench, 1.5),
    (0.6, "litter bin", fixtures.litter_bin, 0.6),
    (0.68, "name sign", fixtures.name_sign, 0.8),
    (0.8, "bush", vegetation.trimmed_box_bush, 0.9),
)


def _path(land: Land, street: Street) -> None:
    """What stands along a path: benches, lamps, bins, beds, sometimes an avenue or a low rail."""
    rng, length = land.rng, street.length
    beyond = street.half_width
    for s in np.arange(rng.uniform(5, 15), length - 5, rng.uniform(20, 35)):
        at, yaw = street.at(s, beyond + 1.3)
        land.grow("lamp", fixtures.lamp, at, 0.5, yaw=float(yaw) - np.pi / 2)
    for s in rng.uniform(6, max(7.0, length - 6), int(length / 9)):
        side = float(rng.choice([-1, 1]))
        at, yaw = street.at(s, side * (beyond + rng.uniform(1.7, 2.2)))
        facing, pick = float(yaw) - side * np.pi / 2, rng.random()
        if pick < 0.8:
            land.grow_one(_BY_PATHS, pick, at, facing)
            continue
        long, wide = rng.uniform([2.0, 1.0], [6.0, 2.0])
        at, _ = street.at(s, side * (beyond + 1.2 + wide / 2))
        if land.ground.claim(at, (long, wide), float(yaw)):
            bed, z = fixtures.flower_bed(rng, long, wide), float(land.terrain.height(*at))
            land.put("flower bed", bed.moved([*at, z], float(yaw)))
    for side in (-1, 1):
        pick = rng.random()
        if pick < 0.2:
            for s in np.arange(6.0, length - 6.0, rng.uniform(7, 11)):
                _tree(land, street.at(s, side * (beyond + 3.0))[0], "lime")
        elif pick < 0.5:
            _edging(land, street, side)
    walkers = rng.uniform(3, max(4.0, length - 3), int(length / 8))
    land.walkers(street.at(walkers, beyond + 1.3)[0])


def _edging(land: Land, street: Street, side: int) -> None:
    """A railing, a low hedge or shrubs along part of a path."""
    rng = land.rng
    begin, end = np.sort(rng.uniform(6.0, max(7.0, street.length - 6.0), 2))
    points = land.line(street.at(np.arange(begin, end, 1.2), side * (street.half_width + 1.9))[0])
    if len(points) < 4:
        return
    line, pick = land.ground_line(points), rng.random()
    if pick < 0.4:
        land.put("railing", fixtures.fence(rng, line))
    elif pick < 0.7:
        land.put("hedge", vegetation.hedge(rng, line, *rng.uniform([0.6, 0.4], [1.4, 0.8])))
    else:
        land.put("shrubs", vegetation.shrubs(rng, line))
    for point in points:
        land.ground.claim(point, (0.8, 0.8), 0.0)


def _features(land: Land) -> None:
    """Statues and fountains where paths meet lawns, a bandstand, a playground."""
    rng, size_m = land.rng, land.ground.size_m
    inside = _MARGIN + 10.0
    for at in rng.uniform(inside, size_m - inside, (int(rng.integers(8, 16)), 2)):
        kind, make = _pick(rng, _ORNAMENTS)
        land.grow(kind, make, at, 3.4, yaw=rng.uniform(0, 6))
    for at in rng.uniform(inside, size_m - inside, (12, 2)):
        if land.grow("bandstand", fixtures.bandstand, at, 7.0, yaw=rng.uniform(0, 6)):
            break
    for middle in rng.uniform(inside, size_m - inside, (2, 2)):
        for _ in range(int(rng.integers(4, 9))):
            kind, make = _pick(rng, _PLAYGROUND)
            at = middle + rng.normal(0, 6.0, 2)
            land.grow(kind, make, at, 3.6, yaw=rng.uniform(0, 6))


_ON_LAWNS: Options = (
    (0.73, "bush", partial(vegetation.grow, kind="hazel", scale=0.7), 1.2),
    (0.77, "sapling", partial(vegetation.grow, kind="sapling"), 0.6),
    (0.79, "stump", vegetation.stump, 1.0),
)


def _lawns(land: Land) -> None:
    """Single trees and groups, bushes, a stump now and then."""
    rng, size_m = land.rng, land.ground.size_m
    spots = scattered(rng, size_m, float(rng.uniform(8.0, 11.0)), 0.6)
    inside = ((spots > _MARGIN + 4) & (spots < size_m - _MARGIN - 4)).all(axis=1)
    bare = rng.uniform(_MARGIN, size_m - _MARGIN, (3, 2)), rng.uniform(10, 24, 3)
    for at in spots[inside]:
        if (np.linalg.norm(at - bare[0], axis=1) < bare[1]).any():
            continue
        pick = rng.random()
        if pick < 0.55:
            _tree(land, at, scale=float(rng.uniform(0.7, 1.1)))
        elif pick < 0.63:
            _tree(land, at, "hawthorn")
        else:
            land.grow_one(_ON_LAWNS, pick, at)
