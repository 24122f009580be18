"""A forest: stands of different trees, planted and wild, clearings, tracks through all of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from segloc.types import Float64

from ..objects import fixtures, vegetation
from .land import Ground, Land, Options, grow_thicket, lay_out, scattered
from .layout import check_world
from .roads import street_network
from .world import Catalogue, World, remember

_STAND = 65.0  # width of a stand, metres
_LOOKED_AT = 20.0  # from a track: small things farther away are left out


@dataclass(frozen=True)
class Stand:
    """A part of a forest in which trees are alike."""

    mix: dict[str, float]  # species and their shares
    spacing: tuple[float, float]  # from tree to tree, metres
    loose: float = 0.55  # how far trees leave their lattice, in steps: 0.1 where planted
    scale: tuple[float, float] = (0.85, 1.15)  # of the trees' heights
    growth: float = 1.5  # thickets, ferns and saplings, in 100 square metres
    fallen: float = 0.5  # logs, stumps and brushwood, in 100 square metres


_MIXED = {
    "oak": 0.32, "ash": 0.18, "birch": 0.14, "hazel": 0.16, "beech": 0.1, "yew": 0.04, "snag": 0.06
}  # fmt: skip
_OPEN = {"hawthorn": 0.3, "birch": 0.2, "sapling": 0.4, "snag": 0.1}

STANDS: tuple[tuple[float, Stand], ...] = (
    (0.18, Stand({"beech": 0.85, "oak": 0.1, "yew": 0.05}, (6.5, 9.0), growth=1.2, fallen=0.6)),
    (0.14, Stand({"spruce": 0.97, "birch": 0.03}, (3.8, 5.0), 0.12, growth=0.6, fallen=0.7)),
    (0.1, Stand({"pine": 0.95, "birch": 0.05}, (4.2, 5.8), 0.15, growth=3.0, fallen=0.5)),
    (0.32, Stand(_MIXED, (5.4, 7.8), growth=5.0, fallen=1.1)),
    (0.1, Stand({"birch": 0.8, "sapling": 0.2}, (3.3, 4.6), scale=(0.6, 0.9), growth=2.0)),
    (0.08, Stand({"ash": 0.85, "snag": 0.15}, (4.5, 6.2), 0.25, growth=3.5, fallen=1.1)),
    (0.08, Stand(_OPEN, (8.0, 14.0), growth=5.0)),
)
"""Shares and stands: beech, rows of spruce and of pine, mixed, young birches, ash, clearing."""


_PLANTED = Stand({"spruce": 1.0}, (3.8, 4.4), 0.04, scale=(0.97, 1.03), growth=0.3, fallen=0.1)


@remember
def forest(seed: int, *, size_m: float = 280.0, repetition: float = 0.0) -> World:
    """A forest of about ``size_m`` metres square; the same for the same seed.

    Parameters
    ----------
    repetition : float
        Share of the stands that are spruces planted in rows, and of the trees that are of a few
        shapes, 0 to 1.
    """
    check_world(seed, size_m, 100.0, 400.0)
    catalogue = Catalogue(seed, repetition)
    rng = np.random.default_rng([seed, 15_485_863])
    tracks = street_network(
        rng,
        size_m,
        margin_m=30.0,
        block_m=float(rng.uniform(62, 80)),
        half_width=(1.9, 2.4),
        shift=0.27,
        bend=0.2,
    )
    ground = Ground(
        slope=rng.uniform(0.03, 0.06), humps=rng.uniform(0.05, 0.1), rough=0.045, ditches=0.7
    )
    land = lay_out(rng, tracks, size_m, ground)
    land.catalogue = catalogue
    _by_the_tracks(land)
    seeds = rng.uniform(0, size_m, (max(4, int((size_m / _STAND) ** 2)), 2))
    shares = np.array([share for share, _ in STANDS])
    chosen = rng.choice(len(STANDS), len(seeds), p=shares / shares.sum())
    nearest = cKDTree(seeds)
    for k, pick in enumerate(chosen):
        planted = repetition > 0 and rng.random() < repetition
        _plant(land, _PLANTED if planted else STANDS[pick][1], partial(_belongs, nearest, k))
    return land.world("forest", seed)


def _belongs(seeds: cKDTree, stand: int, xy: Float64) -> np.ndarray:
    """Which points (n, 2) are nearest to the seed of a stand."""
    return np.asarray(seeds.query(xy)[1] == stand)


def _plant(land: Land, stand: Stand, mine: Callable[[Float64], np.ndarray]) -> None:
    rng, size_m = land.rng, land.ground.size_m
    spacing = float(rng.uniform(*stand.spacing))
    points = scattered(rng, size_m, spacing, stand.loose)
    points = points[mine(points)]
    kinds = rng.choice(list(stand.mix), len(points), p=np.array(list(stand.mix.values())))
    for at, kind in zip(points[rng.random(len(points)) < 0.88], kinds, strict=False):
        source = land.like(f"tree {kind}")
        detail, scale = land.detail(at), float(source.uniform(*stand.scale))
        make = partial(vegetation.grow, kind=str(kind), detail=detail, scale=scale)
        land.grow("tree", make, at, 1.2, source=source)
    patches = scattered(rng, size_m, 10.0 / np.sqrt(stand.growth), 0.6)
    for at in patches[mine(patches)]:
        if land.distance(at) < _LOOKED_AT:
            _undergrowth(land, at)
    patches = scattered(rng, size_m, 10.0 / np.sqrt(stand.fallen), 0.7)
    for at in patches[mine(patches)]:
        if land.distance(at) < _LOOKED_AT:
            _fallen(land, at)


_SAPLINGS: Options = (
    (0.8, "sapling", partial(vegetation.grow, kind="sapling"), 0.5),
    (0.9, "bush", partial(vegetation.grow, kind="hazel", scale=0.6), 0.8),
    (1.0, "bush", lambda rng: vegetation.grow(rng, "yew", scale=rng.uniform(0.4, 0.8)), 1.2),
)
_FALLEN: Options = (
    (0.7, "stump", vegetation.stump, 0.9),
    (0.9, "brushwood", vegetation.brushwood, 1.2),
    (1.0, "boulder", vegetation.boulder, 1.0),
)


def _undergrowth(land: Land, at: Float64) -> None:
    rng, pick = land.rng, land.rng.random()
    if pick < 0.3:
        grow_thicket(land, at, [0.5, 0.5], [1.9, 1.7])
    elif pick < 0.55:
        for spot in at + rng.normal(0, 1.0, (int(rng.integers(1, 6)), 2)):
            land.grow("fern", vegetation.fern, spot, 0.5)
    else:
        land.grow_one(_SAPLINGS, pick, at)


def _fallen(land: Land, at: Float64) -> None:
    rng, pick = land.rng, land.rng.random()
    if pick >= 0.4:
        land.grow_one(_FALLEN, pick, at)
        return
    turn, long = rng.uniform(0, 2 * np.pi), rng.uniform(2.0, 12.0)
    way = np.array([np.cos(turn), np.sin(turn)])
    points = land.line(at + np.linspace(0, long, 10)[:, None] * way)
    if len(points) > 3:
        land.put("log", vegetation.log(rng, land.ground_line(points)))
        if rng.random() < 0.3:
            land.grow("root plate", vegetation.root_plate, at - 0.4 * way, 0.8, yaw=turn)


_BY_TRACKS: Options = (
    (0.5, "bench", fixtures.bench, 1.6),
    (0.65, "name sign", fixtures.name_sign, 1.0),
)


def _by_the_tracks(land: Land) -> None:
    """Woodpiles, benches, sign boards; somebody walking."""
    rng = land.rng
    for street in land.roads.streets:
        for s in rng.uniform(6, max(7.0, street.length - 6), 1 + int(street.length / 30)):
            side = float(rng.choice([-1, 1]))
            at, yaw = street.at(s, side * (street.half_width + rng.uniform(2.2, 3.2)))
            facing = float(yaw) - side * np.pi / 2
            pick = rng.random()
            if pick < 0.35:
                land.grow("woodpile", vegetation.woodpile, at, 2.4, yaw=float(yaw) - np.pi / 2)
            else:
                land.grow_one(_BY_TRACKS, pick, at, facing)
        walkers = rng.uniform(5, max(6.0, street.length - 5), int(street.length / 25))
        land.walkers(street.at(walkers, street.half_width + 1.4)[0])
