"""Time until kidnapped robots are detected, if odometry does not notice.

    python -m segloc_lab.protocols.kidnapping --worlds 48 --out kidnapping.jsonl
    python -m segloc_lab.protocols.kidnapping --alike --worlds 42 --trials 3 --out alike.jsonl
    python -m segloc_lab.protocols.kidnapping --handled --worlds 14 --trials 5 --out handled.jsonl
    python -m segloc_lab.protocols.kidnapping --lifted --worlds 4 --trials 7 --out lifted.jsonl

A part of each world is mapped in one session and driven through in another, with other cars and a
tenth of the things replaced. Each robot drives 40 m along the map. Then it is put to another street
(20 m away at least), to a place that is not in the map, or turned on the spot, and drives on for
100 m, or as far as the drive goes: if possible 60 m along the map. Its odometry drifts by 1 % and
goes on as if nothing had happened. With ``--alike``, it is put to the place whose view is most
alike by heights and free space all around it, 12 m away at least, turned as is most alike.
With ``--handled``, trials take turns: it is put to another street, its sensor tilted by 5 to 10
degrees; it is turned by half on the spot; it is put to the place whose view is most alike in a
mirror, 12 m away at least; or it drives from one half of the mapped way into the other, and the map
of the half before is replaced by that of the other, with the pose there supposed, or not.
With ``--lifted``, buildings of three storeys of one plan are mapped, all of them; the robot rides a
lift to the same place of another storey. Trials differ by the heights that it observes: none; those
of a barometer, 0.5 m off at random and drifting by 1 m; the same with every twentieth wrong by up
to 10 m; the same with those of the old storey for 5 m after the lift; and those before the lift
alone. In two more each storey has a map of its own, which is loaded after the ride, with the pose
there supposed, or not.
Noticed: no longer localized. Recovered: localized within 2 m and 10 degrees of the truth, where the
map has the place. Held: metres of the whole trial localized farther off than that.

Each seed is a world of its own, so runs of different seeds can work at once. What was tried is
kept, a line a trial, and a run goes on where the last one ended. ``--add`` adds up.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from segloc import Config, Localizer, Scan, SegmentMap, build_map, geometry
from segloc.live import LiveCore, Replay, State, Status, play, pose_errors
from segloc.tools.batch import COVERAGE_RADIUS_M, distances_to_path
from segloc.tools.datasets import Selection
from segloc.types import Derived, Float64, Int64, Pose, Recording

from ..recordings import Cached
from ..report import Cell, Table, publish, share
from ..runner import Runner
from ..simulation import (
    PLATFORMS,
    SCENES,
    SENSORS,
    Conditions,
    OdometryNoise,
    SimulatedSequence,
    building,
    simulate_sessions,
)
from ..simulation import World as SimulatedWorld
from .follower import taken

BEFORE_M, AFTER_M, AWAY_M, OUTSIDE_M = 40.0, 100.0, 20.0, 20.0
ALIKE_M = 12.0
TURN_DEG = (40.0, 180.0)
OFF_M, OFF_DEG = 2.0, 10.0
NOTICED_M, RECOVERED_M, HELD_M = 30.0, 60.0, 5.0
MAPPED_SHARE, RATE_HZ = 0.6, 10.0
DRIFT = OdometryNoise(drift_m=0.03, drift_deg=0.04, scale=0.01)
WAYS = ("street", "turn", "outside")
"""Places to which robots are kidnapped."""
ALIKE = "alike"
HANDLED = (
    "tilted",
    "turned by half",
    "mirrored",
    "map of the other half, pose",
    "map of that half",
)
"""What is done to robots of ``--handled``, in turn."""
TILT_DEG = (5.0, 10.0)
SECTORS, REACH_M, TALL_M = 60, 40.0, 6.0
"""Directions in which views are compared, and where distances and heights are cut off."""


@dataclass(frozen=True)
class Kind:
    """A kind of world and its platform."""

    scene: str
    sensor: str
    size_m: float = 330.0
    length_m: float = 500.0
    spacing_m: float = 2.0
    platform: str | None = None
    storeys: int = 1
    differ: float = 0.0

    def drives(
        self, world: SimulatedWorld, seed: int, replaced: float, storey: int = 0
    ) -> list[SimulatedSequence]:
        """Simulate the drive that is mapped, and a later one with a share of things replaced."""
        return simulate_sessions(
            world,
            SENSORS[self.sensor]().thinned(4 if self.sensor == "hdl64e" else 2),
            [Conditions(), Conditions(replaced=replaced)],
            length_m=self.length_m,
            spacing_m=self.spacing_m,
            seed=seed,
            platform=PLATFORMS[self.platform]() if self.platform else None,
            storey=storey,
        )


KINDS = (
    Kind("town", "hdl64e"),
    Kind("industrial", "vlp16", 250.0),
    Kind("park", "os1-64", 250.0),
    Kind("offices", "os1-64", 80.0, 220.0, 0.5, "wheeled"),
    Kind("town", "vlp16"),
    Kind("industrial", "os1-64", 250.0),
    Kind("park", "hdl64e", 250.0),
    Kind("warehouse", "vlp16", 80.0, 220.0, 0.5, "wheeled"),
)
"""Used in turn."""
ALIKE_KINDS = (
    Kind("offices", "os1-64", 80.0, 220.0, 0.5, "wheeled"),
    Kind("warehouse", "vlp16", 80.0, 220.0, 0.5, "wheeled"),
    Kind("building", "os1-64", 60.0, 220.0, 0.5, "quadruped"),
    Kind("offices", "vlp16", 80.0, 220.0, 0.5, "wheeled"),
    Kind("mine", "os1-64", 150.0, 300.0, 1.0, "wheeled"),
    Kind("town", "vlp16"),
    Kind("park", "os1-64", 250.0),
)
"""Those of ``--alike``."""
LIFTED_KINDS = (
    Kind("building", "os1-64", 40.0, 120.0, 0.5, "wheeled", 3, 0.0),
    Kind("building", "vlp16", 40.0, 120.0, 0.5, "wheeled", 3, 0.0),
    Kind("building", "os1-64", 40.0, 120.0, 0.5, "wheeled", 3, 0.5),
)
"""Those of ``--lifted``."""
LIFTED = (
    "lift",
    "lift, height",
    "lift, glitches",
    "lift, late height",
    "lift, height before",
    "lift, map with pose",
    "lift, map",
)
LATE_M, GLITCH_M, GLITCHES = 5.0, 10.0, 20
SIGMA_M, WEATHER_M = 0.5, 1.0
"""Noise of a barometer, and its drift over a trial."""


@dataclass(frozen=True)
class Trial:
    """Outcome of one trial; metres, None for events that did not happen."""

    seed: int
    number: int
    scene: str
    sensor: str
    way: str
    known: bool  # before it was carried
    noticed: float | None
    recovered: float | None
    held: float
    carried_on: float  # degraded, with a pose farther off than that


@dataclass(frozen=True)
class Carried(Derived[Recording]):
    """Parts of a drive in sequence, with continuous odometry.

    Attributes
    ----------
    positions : (N,) int64
        In the drive.
    poses : (N, 4, 4) float64
        By odometry.
    turns : (N, 4, 4) float64
        T_drive_sensor: how the robot stands where the drive stood.
    clock : (N,) float64 or None
        Seconds.
    first : int
        Scan at its new place.
    """

    positions: Int64
    poses: Float64
    turns: Float64
    clock: Float64 | None
    first: int

    @property
    def indices(self) -> Int64:
        return np.arange(len(self.positions), dtype=np.int64)

    @property
    def stamps(self) -> Float64 | None:
        return self.clock

    def __len__(self) -> int:
        return len(self.positions)

    def until(self, end: int) -> Carried:
        """Return the drive up to a position after which another drive begins."""
        count = self.first + int(np.searchsorted(self.positions[self.first :], end))
        clock = None if self.clock is None else self.clock[:count]
        kept = self.positions[:count], self.poses[:count], self.turns[:count]
        return Carried(self.source, *kept, clock, self.first)

    def scan(self, i: int) -> Scan:
        points = self.source.scan(int(self.positions[i])).points
        return Scan(geometry.transform(geometry.inverse(self.turns[i]), points))


class World:
    """A map, and a drive with kidnapped robots.

    Attributes
    ----------
    mapped : Recording
        Of which the map was built; its poses are true.
    known : (K,) int64
        Positions of the drive up to which it has been along the map for some scans.
    """

    def __init__(self, kind: Kind, seed: int, replaced: float = 0.1) -> None:
        self.kind, self.seed = kind, seed
        mapped, driven = kind.drives(SCENES[kind.scene](seed, size_m=kind.size_m), seed, replaced)
        ends = mapped.indices[[int((1.0 - MAPPED_SHARE) * len(mapped)), -1]].tolist()
        config = Config(threads=1)
        self.mapped = mapped.select(Selection((tuple(ends),)))
        prior_map = build_map(self.mapped, config)
        self.localizer = Localizer(prior_map, config)
        self.drive: Recording = Cached(driven)
        self.truths = driven.truth
        self._beside = distances_to_path(self.truths, prior_map.trajectory)
        self._inside = inside = self._beside <= COVERAGE_RADIUS_M
        self.known = np.array(
            [k for k in np.flatnonzero(inside) if inside[max(0, k - 10) : k].all()], dtype=np.int64
        )

    def trial(self, number: int) -> Trial:
        """Return one trial; reproducible by its number."""
        rng = np.random.default_rng([self.seed, number])
        way = WAYS[number % len(WAYS)]
        taken, put, way = self._places(way, rng)
        degrees = float(rng.uniform(*TURN_DEG) * rng.choice([-1.0, 1.0])) if way == "turn" else 0.0
        turn = geometry.yaw_transform(np.radians(degrees))
        return self._tried(number, way, self._carried(taken, put, turn, rng))

    def handled(self, number: int) -> Trial | None:
        """Return one trial of a robot that is handled; None if the drive has no place for it."""
        way = HANDLED[number % len(HANDLED)]
        rng = np.random.default_rng([self.seed, number])
        if "map" in way:
            return self._loaded(number, way, rng)
        if way == "mirrored":
            carried = self.carried_alike(number, mirrored=True)
            return None if carried is None else self._tried(number, way, carried)
        if way == "tilted":
            taken, put, _ = self._places("street", rng)
            T = _tilted(np.radians(rng.uniform(*TILT_DEG)), rng.uniform(-np.pi, np.pi))
        else:
            taken, put, _ = self._places("turn", rng)
            T = geometry.yaw_transform(np.pi)
        return self._tried(number, way, self._carried(taken, put, T, rng))

    def _loaded(self, number: int, way: str, rng: np.random.Generator) -> Trial | None:
        """Return one trial of a robot that drives into the other half of the map."""
        count, spacing = len(self.mapped), self.kind.spacing_m
        known = self.known[self.known >= BEFORE_M / spacing]
        halves = [
            self.mapped.select(Selection((tuple(self.mapped.indices[ends].tolist()),)))
            for ends in ([0, count // 2], [count // 2, count - 1])
        ]
        paths = [half.poses for half in halves]
        beside = np.stack([distances_to_path(self.truths, T) <= COVERAGE_RADIUS_M for T in paths])
        least, most = int(BEFORE_M / spacing), int(RECOVERED_M / spacing)
        best: tuple[float, int, int] | None = None
        for k in known.tolist():
            for old in range(2):
                share = beside[old, k - least : k].mean() + beside[1 - old, k : k + most].mean()
                if len(self.truths) - k >= most / 2 and (best is None or share > best[0]):
                    best = share, k, old
        if best is None:
            return None
        _, at, old = best
        config = self.localizer.config
        before, beyond = (Localizer(build_map(halves[k], config), config) for k in (old, 1 - old))
        carried = self._carried(at, at, np.eye(4), rng)
        T_new_old = np.eye(4) if "pose" in way else None
        played = _loading(before, beyond, carried, T_new_old)
        return self._counted(number, way, carried, self._judged(carried, played))

    def alike(self, number: int) -> Trial | None:
        """Return one trial of a robot that is put to where most is alike; None without a place."""
        carried = self.carried_alike(number)
        return None if carried is None else self._tried(number, ALIKE, carried)

    def carried_alike(self, number: int, *, mirrored: bool = False) -> Carried | None:
        """Return the drive of that robot, reproducible by its number.

        With ``mirrored``, to where the view is most alike in a mirror.
        """
        rng, spacing = np.random.default_rng([self.seed, number]), self.kind.spacing_m
        known = self.known[self.known >= BEFORE_M / spacing]
        stretches = (self._whole(self._inside, m) for m in (RECOVERED_M, RECOVERED_M / 2))
        there = next((found for found in stretches if len(found)), known)[:: round(2.0 / spacing)]
        if not len(known):
            return None
        taken = int(rng.choice(known))
        off = self.truths[there, :3, 3] - self.truths[taken, :3, 3]
        there = there[np.linalg.norm(off, axis=1) >= ALIKE_M]
        if not len(there):
            return None
        views = {int(k): self._view(int(k)) for k in (taken, *there)}
        here = views[taken][:, ::-1] if mirrored else views[taken]
        unlike = {k: _unlike(here, views[k]) for k in there.tolist()}
        put = min(unlike, key=lambda k: unlike[k])
        return self._carried(taken, put, geometry.yaw_transform(unlike[put][1]), rng)

    def from_anywhere(
        self, metres: float, covered_m: float, rng: np.random.Generator
    ) -> Carried | None:
        """Return a part of the drive that begins anywhere; None if it does not meet the map.

        For ``covered_m`` it is within coverage.
        """
        begins = self._whole(self._inside, covered_m)
        if not len(begins):
            return None
        begin = int(rng.choice(begins))
        end = min(begin + int(metres / self.kind.spacing_m), len(self.truths))
        positions = np.arange(begin, end)
        clock = None if self.drive.stamps is None else self.drive.stamps[positions]
        poses = DRIFT.odometry(self.truths[positions], rng)
        turns = np.tile(np.eye(4), (len(positions), 1, 1))
        return Carried(self.drive, positions, poses, turns, clock, 0)

    def _view(self, position: int) -> Float64:
        """Return the distance and the height of what is nearest in each direction, (2, S)."""
        T = self.truths[position]
        points = self.drive.scan(position).points.astype(np.float64)
        points = points @ (geometry.inverse(geometry.levelled(T)) @ T)[:3, :3].T
        reach = np.hypot(points[:, 0], points[:, 1])
        turn = np.arctan2(points[:, 1], points[:, 0]) % (2.0 * np.pi)
        sector = np.minimum((turn * SECTORS / (2.0 * np.pi)).astype(int), SECTORS - 1)
        view = np.stack([np.full(SECTORS, REACH_M), np.zeros(SECTORS)])
        stands = (points[:, 2] > -0.5) & (reach < REACH_M)
        np.minimum.at(view[0], sector[stands], reach[stands])
        np.maximum.at(view[1], sector[stands], np.minimum(points[stands, 2], TALL_M))
        return view / [[REACH_M], [TALL_M]]

    def followed(
        self, carried: Carried, heights: list[tuple[float, float] | None] | None = None
    ) -> Localized:
        """Return where segloc localizes the robot of a drive, which may observe its height."""
        played = play(self.localizer, carried, heights=heights)
        return self._judged(carried, played)

    def _judged(self, carried: Carried, played: Replay) -> Localized:
        """Return where the robot of a drive is localized."""
        metres, degrees = pose_errors(played, self.truths_of(carried))
        kinds = [played.states[int(k)].status for k in played.positions]
        off = ~((metres <= OFF_M) & (degrees <= OFF_DEG))
        sure = np.array([kind is Status.LOCALIZED for kind in kinds])
        degraded = np.array([kind is Status.DEGRADED for kind in kinds])
        return Localized(sure & ~off, sure & off, degraded & off)

    def truths_of(self, carried: Carried) -> Float64:
        """Return the true poses of the robot of a drive, (N, 4, 4)."""
        return self.truths[carried.positions] @ carried.turns

    def _tried(
        self,
        number: int,
        way: str,
        carried: Carried,
        heights: list[tuple[float, float] | None] | None = None,
    ) -> Trial:
        return self._counted(number, way, carried, self.followed(carried, heights))

    def _counted(self, number: int, way: str, carried: Carried, found: Localized) -> Trial:
        """Return the trial of a robot that was followed."""
        path = geometry.distance_travelled(self.truths_of(carried)[carried.first :])
        kind = self.kind
        return Trial(
            self.seed,
            number,
            kind.scene,
            kind.sensor,
            way,
            **events(found, carried.first, path, kind.spacing_m),
            carried_on=kind.spacing_m * int(found.carried_on.sum()),
        )

    def _places(self, way: str, rng: np.random.Generator) -> tuple[int, int, str]:
        """Return where a robot is taken from and put to; another place if there is none."""
        spacing, truths = self.kind.spacing_m, self.truths
        before = int(BEFORE_M / spacing)
        inside, known = self._inside, self.known
        known = known[known >= before] if (known >= before).any() else known
        taken = int(rng.choice(known))
        if way == "outside":
            beyond = self._whole(self._beside > OUTSIDE_M, NOTICED_M)
            if len(beyond):
                return taken, int(rng.choice(beyond)), way
        stretches = [self._whole(inside, metres) for metres in (RECOVERED_M, RECOVERED_M / 2)]
        for whole in stretches if way != "turn" else ():
            away = np.linalg.norm(truths[whole, :2, 3] - truths[taken, :2, 3], axis=1)
            if (away >= AWAY_M).any():
                return taken, int(rng.choice(whole[away >= AWAY_M])), "street"
        stays = [np.intersect1d(known, whole) for whole in stretches]
        place = int(rng.choice(next((found for found in stays if len(found)), known)))
        return place, place, "turn"

    def _whole(self, where: NDArray[np.bool_], metres: float) -> Int64:
        """Return positions with a complete stretch of the drive after them."""
        count = int(metres / self.kind.spacing_m)
        return np.array(
            [k for k in range(len(where) - count + 1) if where[k : k + count].all()], dtype=np.int64
        )

    def _carried(self, taken: int, put: int, turn: Pose, rng: np.random.Generator) -> Carried:
        """Return the scans up to one place and from another on, turned there."""
        spacing, truths = self.kind.spacing_m, self.truths
        first = np.arange(max(0, taken - int(BEFORE_M / spacing)), taken + 1)
        second = np.arange(put, min(put + int(AFTER_M / spacing), len(truths)))
        turns = np.tile(np.eye(4), (len(first) + len(second), 1, 1))
        turns[len(first) :] = turn
        there = truths[second] @ turns[len(first) :]
        T = truths[taken] @ geometry.inverse(there[0])  # as if it had gone on from there
        moved = np.concatenate([truths[first], T @ there])
        positions = np.concatenate([first, second])
        clock = self._clock(first, second)
        return Carried(self.drive, positions, DRIFT.odometry(moved, rng), turns, clock, len(first))

    def _clock(self, first: Int64, second: Int64) -> Float64 | None:
        """Return the drive's stamps, with a second between its parts."""
        stamps = self.drive.stamps
        if stamps is None:
            return None
        later = stamps[second] - stamps[second[0]] + stamps[first[-1]] + 1.0
        return np.concatenate([stamps[first], later])


@dataclass(frozen=True)
class Joined(Derived[Recording]):
    """Recordings one after another, of which the source is the first."""

    parts: tuple[Recording, ...]

    poses = None

    @property
    def indices(self) -> Int64:
        return np.arange(sum(map(len, self.parts)), dtype=np.int64)

    @property
    def stamps(self) -> Float64 | None:
        known = [part.stamps for part in self.parts if part.stamps is not None]
        return np.concatenate(known) if len(known) == len(self.parts) else None

    def scan(self, i: int) -> Scan:
        for part in self.parts:
            if i < len(part):
                return part.scan(i)
            i -= len(part)
        raise IndexError(i)


class Building(World):
    """A map of all storeys of a building, and the same drive on each of them."""

    def __init__(self, kind: Kind, seed: int, replaced: float = 0.1) -> None:
        self.kind, self.seed = kind, seed
        world = building(seed, size_m=kind.size_m, storeys=kind.storeys, differ=kind.differ)
        config = Config(threads=1)
        days = [kind.drives(world, seed, replaced, storey) for storey in range(kind.storeys)]
        maps = [build_map(mapped, config) for mapped, _ in days]
        drives = [Cached(later) for _, later in days]
        self.localizer = Localizer(functools.reduce(SegmentMap.merge, maps), config)
        self.storeys = [Localizer(each, config) for each in maps]
        self.drive = Joined(drives[0], tuple(drives))
        self._length = min(map(len, drives))
        self.truths = np.concatenate([later.truth for _, later in days])

    def lifted(self, number: int) -> Trial:
        """Return one trial of a robot that rides a lift; reproducible by its number."""
        way = LIFTED[number % len(LIFTED)]
        rng = np.random.default_rng([self.seed, number // len(LIFTED)])
        spacing, length = self.kind.spacing_m, self._length
        start, end = rng.choice(self.kind.storeys, 2, replace=False)
        least, most = BEFORE_M / spacing, length - RECOVERED_M / spacing
        at = int(rng.uniform(least, max(least + 1, most)))
        carried = self._carried(at + start * length, at + end * length, np.eye(4), rng)
        carried = carried.until((end + 1) * length)
        if "map" not in way:
            return self._tried(number, way, carried, self._heights(way, carried, rng))
        rise = self.truths[at + end * length, 2, 3] - self.truths[at + start * length, 2, 3]
        T_new_old = geometry.yaw_transform(0.0, (0.0, 0.0, rise)) if "pose" in way else None
        played = _loading(self.storeys[start], self.storeys[end], carried, T_new_old)
        return self._counted(number, way, carried, self._judged(carried, played))

    def _heights(
        self, way: str, carried: Carried, rng: np.random.Generator
    ) -> list[tuple[float, float] | None] | None:
        """Return what the robot observes of its height before each scan; None for nothing."""
        if way == "lift":
            return None
        count, first = len(carried), carried.first
        heights = self.truths_of(carried)[:, 2, 3].copy()
        if "late" in way:
            heights[first : first + int(LATE_M / self.kind.spacing_m)] = heights[first - 1]
        if "glitches" in way:
            heights[rng.permutation(count)[: count // GLITCHES]] += rng.uniform(-GLITCH_M, GLITCH_M)
        drift = WEATHER_M * np.linspace(0.0, rng.choice([-1.0, 1.0]), count)
        heights += drift + rng.normal(0.0, SIGMA_M, count)
        known = first if "before" in way else count
        return [(float(height), SIGMA_M) if k < known else None for k, height in enumerate(heights)]


@dataclass(frozen=True)
class Localized:
    """Scans of a drive that are localized within the tolerance, beyond it, and degraded beyond it.

    Each is (N,) bool.
    """

    right: NDArray[np.bool_]
    false: NDArray[np.bool_]
    carried_on: NDArray[np.bool_]


class Events(TypedDict):
    """What became of a robot, as in :class:`Trial`."""

    known: bool
    noticed: float | None
    recovered: float | None
    held: float


def events(found: Localized, first: int, path: Float64, spacing_m: float) -> Events:
    """Return what became of a robot whose scan ``first`` is the first at its new place.

    path: (M,) distance travelled from there on [m]
    """

    def reached(where: NDArray[np.bool_]) -> float | None:
        return round(float(path[int(where.argmax())]), 1) if where.any() else None

    return {
        "known": bool(found.right[first - 1]),
        "noticed": reached(~found.false[first:]),
        "recovered": reached(found.right[first:]),
        "held": spacing_m * int(found.false.sum()),
    }


def _loading(old: Localizer, new: Localizer, carried: Carried, T_new_old: Pose | None) -> Replay:
    """Play a drive whose map is replaced at the first scan of its second part.

    With ``T_new_old``, the pose by the old map is supposed in the new one.
    """
    clock = np.arange(len(carried)) / RATE_HZ if carried.clock is None else carried.clock
    core, states = LiveCore(old), dict[int, State]()
    for i, stamp in enumerate(clock.tolist()):
        T_map_odom = core.state.T_map_odom
        if i == carried.first:
            core = LiveCore(new)
        core.add_odometry(stamp, carried.poses[i])
        if i == carried.first and T_new_old is not None and T_map_odom is not None:
            core.tracker.suppose(T_new_old @ T_map_odom)
        states[i], *_ = taken(core, stamp, carried.scan(i).points, None)
    return Replay(states, np.empty(0), np.empty(0), len(states), 0, 0)


def _tilted(tilt: float, towards: float) -> Pose:
    """Return how a sensor stands that is tilted towards a direction [rad]."""
    step = tilt * np.array([-np.sin(towards), np.cos(towards), 0.0, 0.0, 0.0, 0.0])
    return geometry.displace(np.eye(4), step)


def _unlike(here: Float64, there: Float64) -> tuple[float, float]:
    """Return how views differ at most alike, and the turn of the sensor there [rad]."""
    differ = [np.abs(here - np.roll(there, k, axis=1)).mean() for k in range(SECTORS)]
    least = int(np.argmin(differ))
    return float(differ[least]), -2.0 * np.pi * least / SECTORS


def table(found: list[Trial]) -> list[dict[str, Cell]]:
    """Return one row per kind of world, one per way, and one of all."""
    parts = {
        (scene, sensor, "all"): [t for t in found if (t.scene, t.sensor) == (scene, sensor)]
        for scene, sensor in dict.fromkeys((t.scene, t.sensor) for t in found)
    }
    for way in dict.fromkeys(t.way for t in found):
        parts["all", "all", way] = [t for t in found if t.way == way]
    parts["all", "all", "all"] = found
    return [
        {"world": world, "sensor": sensor, "carried to": way, **became(part)}
        for (world, sensor, way), part in parts.items()
    ]


def became(found: list[Trial]) -> dict[str, Cell]:
    """Return what became of the robots of some trials, as cells of a row."""
    known = [t for t in found if t.known]
    mapped = [t for t in known if t.way != "outside"]
    noticed = [np.inf if t.noticed is None else t.noticed for t in known]
    recovered = [np.inf if t.recovered is None else t.recovered for t in mapped]
    held = [t.held for t in found]
    in_time = int((np.array(noticed) <= NOTICED_M).sum())
    again = int((np.array(recovered) <= RECOVERED_M).sum())
    return {
        "trials": len(found),
        "known before": len(known),
        f"noticed within {NOTICED_M:g} m": share(in_time, len(known)),
        f"recovered within {RECOVERED_M:g} m": share(again, len(mapped)),
        f"false for more than {HELD_M:g} m": int((np.array(held) > HELD_M).sum()),
        "noticed, median / worst (m)": _spread(noticed),
        "recovered, median / worst (m)": _spread(recovered),
        "held, worst (m)": max(held, default=0.0),
    }


def _spread(values: list[float]) -> str:
    if not values:
        return "-"
    both = float(np.median(values)), max(values)
    return " / ".join("never" if np.isinf(each) else f"{each:.0f}" for each in both)


def report(found: list[Trial], folder: Path | None) -> None:
    """Publish the table."""
    note = "Recovered: of those known before and put where the map has the place."
    publish(folder, "Robots that are carried away", Table.of(table(found), note))


@functools.lru_cache(maxsize=2)
def world_of(kinds: tuple[Kind, ...], seed: int, replaced: float = 0.1) -> World:
    """Make the world of a seed, of kinds that take turns; the last ones are kept."""
    return World(kinds[seed % len(kinds)], seed, replaced)


@functools.lru_cache(maxsize=1)
def building_of(seed: int) -> Building:
    """Make the building of a seed, of kinds that take turns; the last one is kept."""
    return Building(LIFTED_KINDS[seed % len(LIFTED_KINDS)], seed)


def trials_of(results: Iterable[Mapping[str, Any]]) -> list[Trial]:
    """Return the trials of results, each once."""
    found = {(each["seed"], each["number"]): Trial(**each) for each in results}
    return [found[key] for key in sorted(found)]


def main() -> None:
    runner = Runner(__doc__, "kidnapping.jsonl", first_seed=4104, worlds=48, choosing=("trials",))
    add = runner.options.add_argument
    add("--trials", type=int, default=5, help="in each world")
    add("--alike", action="store_true", help="carry them to where most is alike")
    add("--handled", action="store_true", help="tilt, turn or mirror them, or load another map")
    add("--lifted", action="store_true", help="let them ride lifts")
    args = runner.parse()

    def tried(task: tuple[int, int]) -> dict[str, Any] | None:
        seed, number = task
        if args.lifted:
            return asdict(building_of(seed).lifted(number))
        world = world_of(ALIKE_KINDS if args.alike or args.handled else KINDS, seed)
        if not len(world.known):  # a drive need not meet the map
            return None
        if args.handled:
            trial = world.handled(number)
        else:
            trial = world.alike(number) if args.alike else world.trial(number)
        return None if trial is None else asdict(trial)

    tasks = itertools.product(runner.seeds, range(args.trials))
    report(trials_of(runner.run(tried, tasks, ("seed", "number"))), args.report)


if __name__ == "__main__":
    main()
