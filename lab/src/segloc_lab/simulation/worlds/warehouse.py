"""Warehouses: large halls on a lattice of pillars, rows of racks, dock doors, some halls bare."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segloc.types import Float64

from ..objects.furniture import (
    beams,
    cage,
    conveyor,
    dock_door,
    machine,
    pallet_load,
    pillar,
    rack,
    slab,
    wall,
    wall_things,
)
from ..objects.mesh import boxes, xyz
from .fitting import Fitting
from .layout import check_world
from .roads import RoadNetwork, straight
from .world import World, remember

_BAY = 2.75  # of racks, metres
_RACK = 2.5  # depth of two racks back to back
_GATE = 4.0
_NONE = np.zeros((0, 4))


@dataclass(frozen=True)
class Hall:
    """One hall of a warehouse; metres.

    Its style is "bare" (pillars and next to nothing else), "racks" (rows of racks) or "mixed" (some
    racks, machines, and goods on the floor).
    """

    start: float  # along the building, as its end
    end: float
    pitch: tuple[float, float]  # between pillars, along and across the building
    high: float  # of its ceiling
    style: str
    columns: tuple[float, ...]  # where ways lead across


@remember
def warehouse(seed: int, *, size_m: float = 110.0, repetitive: bool | None = None) -> World:
    """A warehouse of about ``size_m`` metres in length; the same for the same seed.

    Parameters
    ----------
    repetitive : bool, optional
        Whether all of its halls are bare, or none; without it some are.
    """
    check_world(seed, size_m, 40.0, 400.0)
    rng = np.random.default_rng([seed, 49_979_687])
    halls, rows = _plan(rng, size_m, repetitive)
    across = halls[0].pitch[1]
    gates = [rng.permutation(rows)[: int(rng.integers(1, rows))].tolist() for _ in halls[1:]]
    roads = _aisles(halls, rows, gates)
    site = Fitting(rng, (halls[-1].end, rows * across), roads)
    for hall in halls:
        _pillars(site, hall, rows)
        _ceiling(site, hall)
        if hall.style != "bare":
            _racks(site, hall, rows)
        _clutter(site, hall)
    _outer_walls(site, halls)
    for left, hall, open_rows in zip(halls, halls[1:], gates, strict=False):
        middles = [across * (j + 0.5) for j in open_rows]
        _partition(site, hall.start, max(left.high, hall.high), middles)
    return site.world("warehouse", seed)


def _plan(
    rng: np.random.Generator, size_m: float, repetitive: bool | None
) -> tuple[list[Hall], int]:
    """Halls in a row, on lattices of which the pitch across is common to all."""
    count = int(rng.integers(1, max(2, int(size_m / 32)) + 1)) if size_m > 70 else 1
    shares = rng.dirichlet(np.full(count, 8.0)) * size_m
    pitch_y = float(rng.uniform(4.0, 8.0) if repetitive else rng.uniform(5.6, 8.0))
    rows = max(3, round(size_m * rng.uniform(0.45, 0.8) / pitch_y))
    halls, x = [], 0.0
    for share in shares:
        pitch_x = float(rng.uniform(4.0, 8.0))
        bays = max(4, round(share / pitch_x))
        bare = rng.random() < 0.35 if repetitive is None else repetitive
        style = "bare" if bare else str(rng.choice(["racks", "racks", "mixed"]))
        columns = sorted({0, bays - 1} | ({bays // 2} if bays > 7 else set()))
        middles = tuple(x + pitch_x * (k + 0.5) for k in columns)
        high = float(rng.uniform(4.5, 13.0))
        halls.append(Hall(x, x + bays * pitch_x, (pitch_x, pitch_y), high, style, middles))
        x += bays * pitch_x
    return halls, rows


def _aisles(halls: list[Hall], rows: int, gates: list[list[int]]) -> RoadNetwork:
    """Aisles between the rows of pillars, joined by ways across, and through the gates."""
    across = halls[0].pitch[1]
    columns = [x for hall in halls for x in hall.columns]
    of_hall = [k for k, hall in enumerate(halls) for _ in hall.columns]
    nodes = np.array([[x, across * (j + 0.5)] for x in columns for j in range(rows)])
    half = min(1.6, across / 2 - _RACK / 2 - 0.2)
    streets = []
    for i in range(len(columns)):
        for j in range(rows):
            here = i * rows + j
            if j + 1 < rows:
                streets.append(straight(nodes, here, here + 1, 1.3))
            if i + 1 == len(columns):
                continue
            left, right = of_hall[i], of_hall[i + 1]
            if left == right or j in gates[left]:
                streets.append(straight(nodes, here, here + rows, half))
    return RoadNetwork(nodes, tuple(streets))


def _pillars(site: Fitting, hall: Hall, rows: int) -> None:
    """All of one shape, exactly on the lattice."""
    shape = str(site.rng.choice(["square", "round", "steel"]))
    size = float(site.rng.uniform(0.3, 0.6))
    for x in np.arange(hall.start + hall.pitch[0], hall.end - 0.5 * hall.pitch[0], hall.pitch[0]):
        for j in range(1, rows):
            at = np.array([x, j * hall.pitch[1]])
            site.ground.claim(at, (size, size), 0.0)
            site.put("pillar", pillar(shape, size, hall.high), at)


def _ceiling(site: Fitting, hall: Hall) -> None:
    """Girders over the pillars, purlins between them, rows of lamps, a duct or two."""
    rng, (px, py), wide, high = site.rng, hall.pitch, site.size[1], hall.high
    site.put("ceiling", slab([hall.start, 0], [hall.end, wide], high, _NONE, 0.6), np.zeros(2))
    deep = float(rng.uniform(0.4, 1.0))
    begin, end = hall.start + 0.1, hall.end - 0.1
    x, way = begin + px, [end - begin - 1.5 * px, 0, 0]
    girders = beams([x, 0, high], [x, wide, high], way, px, (0.3, deep))
    pitch, way = float(rng.uniform(1.6, 3.0)), [0, wide - 2, 0]
    purlins = beams([begin, 1, high], [end, 1, high], way, pitch, (0.12, 0.25))
    for mesh in (girders, purlins):
        site.put("beams", mesh, np.zeros(2))
    low = high - deep - 0.15
    y = py * (np.arange(int(wide / py)) + 0.5)
    lamps = [[x, v, low] for v in y for x in np.arange(begin + px / 2, end, px)]
    site.put("lamps", boxes(lamps, [1.5, 0.15, 0.1], 0.7), np.zeros(2))
    for v in rng.uniform(1.0, wide - 1.0, int(rng.integers(0, 3))):
        duct = [(begin + end) / 2, v, low - 0.35]
        site.put("duct", boxes(duct, [end - begin, 0.7, 0.5], 0.4), np.zeros(2))


def _racks(site: Fitting, hall: Hall, rows: int) -> None:
    """Double rows of racks on the rows of pillars, broken where ways lead across."""
    rng, across = site.rng, hall.pitch[1]
    step = float(rng.uniform(1.6, 2.0))
    levels: Float64 = 1.6 + step * np.arange(max(1, int((hall.high - 3.6) / step)), dtype=float)
    fill = float(rng.uniform(0.45, 0.95))
    kept = 1.0 if hall.style == "racks" else 0.45
    crossings = [x + s * 1.7 for x in hall.columns for s in (-1, 1)]
    edges = [hall.start + 0.6, *crossings, hall.end - 0.6]
    for j in range(1, rows):
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            bays = int((end - begin) / _BAY)
            if bays < 1 or rng.random() > kept:
                continue
            at = np.array([begin + (end - begin - bays * _BAY) / 2, j * across])
            middle = at + [bays * _BAY / 2, 0.0]
            site.ground.claim(middle, (bays * _BAY, _RACK), 0.0)
            for side in (-1, 1):
                row = at + [0.0, side * 0.7]
                site.put("rack", rack(bays, _BAY, levels, 1.1), row)
                _load(site, row, bays, np.concatenate([[0.0], levels + 0.07]), fill)


def _load(site: Fitting, row: Float64, bays: int, levels: Float64, fill: float) -> None:
    for bay in range(bays):
        for z in levels:
            for k in range(3):
                if site.rng.random() < fill:
                    at = row + [bay * _BAY + 0.5 + 0.87 * k, float(site.rng.normal(0, 0.03))]
                    turn = np.pi / 2 + float(site.rng.normal(0, 0.02))
                    site.put("goods", pallet_load(site.rng), at, turn, float(z))


def _clutter(site: Fitting, hall: Hall) -> None:
    """What stands on the floor, and what comes and goes; little of it where halls are bare."""
    rng, wide = site.rng, site.size[1]
    area = (hall.end - hall.start) * wide
    dense = {"bare": 1 / 700, "racks": 1 / 150, "mixed": 1 / 8}[hall.style]
    for _ in range(int(area * dense)):
        row = hall.pitch[1] * int(rng.integers(0, round(wide / hall.pitch[1]) + 1))
        y = float(np.clip(row + rng.normal(0, 0.5), 1.2, wide - 1.2))  # between the ways
        at, pick = np.array([rng.uniform(hall.start + 1.2, hall.end - 1.2), y]), rng.random()
        yaw = float(rng.choice([0.0, np.pi / 2]) + rng.normal(0, 0.05))
        if pick < 0.5:
            site.stand("goods", pallet_load(rng), at, yaw, (1.3, 0.9))
        elif pick < 0.65:
            site.stand("cages", cage(rng), at, yaw, (1.0, 3.4))
        elif pick < 0.85:
            site.stand("machine", machine(rng), at, 0.0, (3.2, 2.6))
        elif hall.style == "mixed":
            long = float(rng.uniform(5, 14))
            site.stand("conveyor", conveyor(rng, long), at, 0.0, (long, 1.2))
        if rng.random() < 0.5:
            site.people.append(at)
    for _ in range(int(area / 150) + 2):
        at = rng.uniform([hall.start + 1.5, 1.5], [hall.end - 1.5, wide - 1.5])
        if site.claim(at, (2.6, 1.6), 0.0):
            kind = str(rng.choice(["goods", "goods", "cages", "fork lift", "trolley"]))
            site.move_about(kind, at, float(rng.uniform(0, 2 * np.pi)))


def _outer_walls(site: Fitting, halls: list[Hall]) -> None:
    """Piers on the lattice, dock doors on one long side, and what hangs between them."""
    rng, (long, wide) = site.rng, site.size
    for y, yaw in ((0.0, np.pi), (wide, 0.0)):
        doors = rng.random() < 0.7
        for hall in halls:
            _side(site, hall, y, yaw, doors)
    for x, hall, yaw in ((0.0, halls[0], np.pi / 2), (long, halls[-1], -np.pi / 2)):
        site.put("wall", wall([x, 0], [x, wide], (-0.3, hall.high)), np.zeros(2))
        _hang(site, np.array([x, 0.0]), np.array([x, wide]), yaw)


def _side(site: Fitting, hall: Hall, y: float, yaw: float, doors: bool) -> None:
    """A long wall of one hall; ``yaw`` turns what looks towards -y into the hall."""
    rng, px = site.rng, hall.pitch[0]
    wide, high = float(rng.uniform(2.6, 3.4)), float(rng.uniform(2.8, 4.0))
    middles = np.arange(hall.start + px / 2, hall.end, px)
    used = middles[rng.random(len(middles)) < (0.5 if hall.style != "bare" else 0.15)]
    used = used if doors else used[:0]
    holes = [(x - hall.start - wide / 2, x - hall.start + wide / 2, 0.0, high) for x in used]
    site.put("wall", wall([hall.start, y], [hall.end, y], (-0.3, hall.high), holes), np.zeros(2))
    inward = 1.0 if y == 0 else -1.0
    for x in used:
        site.put("dock door", dock_door(rng, wide, high), np.array([x, y]), yaw)
    at = xyz(np.arange(hall.start + px, hall.end - 0.1, px), y + inward * 0.25, hall.high / 2)
    site.put("piers", boxes(at, [0.4, 0.3, hall.high], 0.45), np.zeros(2))
    if hall.style != "bare":
        _hang(site, np.array([hall.start, y]), np.array([hall.end, y]), np.pi / 2 * inward)


def _hang(site: Fitting, start: Float64, end: Float64, yaw: float) -> None:
    """Cabinets, extinguishers and heaters on a wall; x of what hangs leads into the hall."""
    rng = site.rng
    into = np.array([np.cos(yaw), np.sin(yaw)]) * 0.1
    if abs(end[0] - start[0]) < 1e-6:
        into = np.array([0.1 if start[0] == 0 else -0.1, 0.0])
        yaw = 0.0 if start[0] == 0 else np.pi
    for s in rng.uniform(0.03, 0.97, int(np.linalg.norm(end - start) / 9)):
        site.put("fixture", wall_things(rng), start + s * (end - start) + into, yaw)


def _partition(site: Fitting, x: float, high: float, gates: list[float]) -> None:
    """A wall between two halls with a gate for each of the aisles that lead through."""
    top = float(site.rng.uniform(3.4, 4.4))
    holes = [(y - _GATE / 2, y + _GATE / 2, 0.0, top) for y in gates]
    site.put("wall", wall([x, 0], [x, site.size[1]], (-0.3, high), holes, thick=0.3), np.zeros(2))
