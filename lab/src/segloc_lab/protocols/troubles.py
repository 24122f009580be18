"""Robots in trouble: with their odometry, their scans, their surroundings, their way.

    python -m segloc_lab.protocols.troubles --worlds 10 --out troubles.jsonl

Worlds are those of :mod:`.kidnapping`: three fifths are mapped in one session and driven through in
another, past the ends of the map; a tenth of the things is replaced. Counted are scans within 3 m
of the mapped path that are localized rightly, metres localized farther off than 2 m or 10 degrees,
poses published while degraded that are within three of their own standard deviations, and processor
time. A robot without trouble is also switched on anew every 4 m of the mapped way. Of one that
leaves the map and comes back, the metres are counted from the map's end until it is localized.
``--python`` has the robots followed by the version of segloc that another interpreter has.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Scan, __version__, geometry
from segloc.types import Derived, Float64, Int64, Recording

from ..calibration.known import crowded
from ..peers.loops import chained
from ..report import Cell, Table, publish
from ..runner import Runner
from .follower import Follower
from .kidnapping import ALIKE_KINDS, DRIFT, Carried, World, world_of
from .live_streams import RATE_HZ, Message, Stream, is_covered, spread, stream_record

INDOORS_MPS = 1.0
"""Robots outdoors have ten scans a second instead."""
EVERY_M, LASTS_M = 25.0, 1.0
"""Travel from one mishap of the odometry to the next, and its length."""
SLIP_M, TURN_DEG, LONG = 2.0, 8.0, 1.05
JUMP = geometry.yaw_transform(np.radians(90.0), (5.0, 0.0, 0.0))
LATE_S, GAP_S, KEPT = 0.3, 5.0, 3
CROWD_M, OUT_M = 10.0, 30.0
STARTS_M, GIVE_UP_M = 4.0, 60.0
QUARTER = "a quarter is replaced"


def _steps(stream: Stream) -> Float64:
    """The steps to each pose of the odometry, (N, 4, 4)."""
    steps = np.linalg.inv(stream.odometry[:-1]) @ stream.odometry[1:]
    return np.concatenate([np.eye(4)[None], steps])


def _mishaps(stream: Stream) -> Int64:
    """Positions at which something goes wrong."""
    travelled = geometry.distance_travelled(stream.truths)
    return np.searchsorted(travelled, np.arange(EVERY_M, travelled[-1], EVERY_M))


def no_trouble(stream: Stream) -> Stream:
    """Drive past the ends of the map, with odometry that drifts by 1 %."""
    return replace(stream, starts_m=STARTS_M, give_up_m=GIVE_UP_M)


def wheels_slip(stream: Stream) -> Stream:
    """Let the odometry go on by two metres more than the robot, within one."""
    steps, travelled = _steps(stream), geometry.distance_travelled(stream.truths)
    slips = (travelled > EVERY_M) & (travelled % EVERY_M < LASTS_M)
    steps[slips, :3, 3] *= 1.0 + SLIP_M / LASTS_M
    return replace(stream, odometry=chained(steps))


def turned_unnoticed(stream: Stream) -> Stream:
    """Let the robot be turned by eight degrees that the odometry does not see."""
    steps, where = _steps(stream), _mishaps(stream)
    steps[where] = steps[where] @ geometry.yaw_transform(np.radians(TURN_DEG))
    return replace(stream, odometry=chained(steps))


def too_long(stream: Stream) -> Stream:
    """Let all ways of the odometry be five percent too long."""
    steps = _steps(stream)
    steps[:, :3, 3] *= LONG
    return replace(stream, odometry=chained(steps))


def jumps(stream: Stream) -> Stream:
    """Let the odometry jump by five metres and a right angle."""
    steps, where = _steps(stream), _mishaps(stream)
    steps[where] = steps[where] @ JUMP
    return replace(stream, odometry=chained(steps))


def planar(stream: Stream) -> Stream:
    """Let the odometry know way and heading alone: nothing of ramps."""
    steps = _steps(stream)
    yaw, metres = (
        np.arctan2(steps[:, 1, 0], steps[:, 0, 0]),
        np.linalg.norm(steps[:, :3, 3], axis=1),
    )
    forward = [(math.copysign(m, T[0, 3]), 0.0, 0.0) for m, T in zip(metres, steps, strict=True)]
    flat = [geometry.yaw_transform(*step) for step in zip(yaw, forward, strict=True)]
    return replace(stream, odometry=chained(np.array(flat)))


def not_numbers(stream: Stream) -> Stream:
    """Let every seventh pose of the odometry be NaN."""
    odometry = stream.odometry.copy()
    odometry[3::7] = np.nan
    return replace(stream, odometry=odometry)


def odometry_late(stream: Stream) -> Stream:
    """Let the odometry of a scan come 0.3 s after it."""
    count, late = len(stream.odometry), max(1, round(LATE_S * stream.rate_hz))
    messages: list[Message] = []
    for i in range(count + late):
        messages += [("scan", i)] if i < count else []
        messages += [("odometry", i - late)] if i >= late else []
    return replace(stream, messages=messages)


def out_of_order(stream: Stream) -> Stream:
    """Swap poses of the odometry in pairs, and every fifth pair of scans."""
    messages: list[Message] = []
    for i in range(0, len(stream.odometry) - 1, 2):
        scans = (i + 1, i) if i % 10 == 0 else (i, i + 1)
        messages += [("odometry", i + 1), ("odometry", i), *(("scan", k) for k in scans)]
    return replace(stream, messages=messages)


def scans_lost(stream: Stream) -> Stream:
    """Keep every third scan, and none for five seconds every 25 m."""
    gap = round(GAP_S * stream.rate_hz)
    silent = {k for first in _mishaps(stream).tolist() for k in range(first, first + gap)}
    messages: list[Message] = []
    for i in range(len(stream.odometry)):
        arrives = i % KEPT == 0 and i not in silent
        messages += [("odometry", i), ("scan", i)] if arrives else [("odometry", i)]
    return replace(stream, messages=messages)


@dataclass(frozen=True)
class Crowded(Derived[Recording]):
    """People stand around the sensor at some positions."""

    at: frozenset[int]

    poses = None

    def scan(self, i: int) -> Scan:
        """The scan at position i."""
        points = self.source.scan(i).points
        return Scan(crowded(points, i) if i in self.at else points)


def crowd(stream: Stream) -> Stream:
    """Let people stand around the robot along every other 10 m."""
    among = geometry.distance_travelled(stream.truths) % (2.0 * CROWD_M) >= CROWD_M
    at = frozenset(np.flatnonzero(among).tolist())
    return replace(stream, recording=Crowded(stream.recording, at))


def out_and_back(stream: Stream) -> Stream | None:
    """Leave the map by 30 m and come back the same way; None if the drive does not leave it."""
    outside = ~is_covered(stream)
    travelled = geometry.distance_travelled(stream.truths)
    for leaves in np.flatnonzero(~outside[:-1] & outside[1:]):
        first, last = np.searchsorted(travelled, travelled[leaves] + np.array([-OUT_M, OUT_M]))
        inside = not outside[first : leaves + 1].any()
        if inside and last < len(outside) and outside[leaves + 1 : last].all():
            there = np.arange(first, last)
            return _at(stream, np.concatenate([there, there[-2::-1]]))
    return None


def _at(stream: Stream, positions: Int64) -> Stream:
    """The scans at positions of a drive, with odometry of their own."""
    truths, count = stream.truths[positions], len(positions)
    odometry = DRIFT.odometry(truths, np.random.default_rng(stream.seed))
    still = np.tile(np.eye(4), (count, 1, 1))
    drive = Carried(stream.recording, positions, odometry, still, None, count // 2)
    return replace(stream, recording=drive, odometry=odometry, truths=truths)


TROUBLES: dict[str, Callable[[Stream], Stream | None]] = {
    "none": no_trouble,
    "wheels slip by 2 m every 25 m": wheels_slip,
    "turned by 8 degrees every 25 m, unnoticed": turned_unnoticed,
    "odometry 5 % too long": too_long,
    "odometry jumps by 5 m and 90 degrees every 25 m": jumps,
    "planar odometry": planar,
    "a seventh of the odometry NaN": not_numbers,
    "odometry 0.3 s late": odometry_late,
    "odometry and scans out of order": out_of_order,
    "one scan of three, gaps of 5 s": scans_lost,
    "people all around, half of the way": crowd,
    "out of the map and back": out_and_back,
    QUARTER: lambda stream: stream,
}


@functools.lru_cache(maxsize=2)
def follower_of(python: Path, world: World) -> Follower:
    """Map a world by the version of another interpreter."""
    mapped = (world.mapped.scan(i) for i in range(len(world.mapped)))
    return Follower(python, [(scan.points, scan.T_odom_sensor) for scan in mapped])


def stream_of(world: World) -> Stream:
    """The drive of a world, without trouble."""
    odometry = DRIFT.odometry(world.truths, np.random.default_rng(world.seed))
    indoors = world.kind.platform is not None
    rate_hz = INDOORS_MPS / world.kind.spacing_m if indoors else RATE_HZ
    what = world.kind.scene, world.seed, world.localizer, world.drive, odometry, world.truths
    return Stream(*what, rate_hz=rate_hz, starts_m=np.inf)


def record(world: World, trouble: str, python: Path | None = None) -> dict[str, Any] | None:
    """Drive with a trouble; None where it cannot be."""
    follower = None if python is None else follower_of(python, world)
    stream = TROUBLES[trouble](replace(stream_of(world), follower=follower))
    if stream is None:
        return None
    found = stream_record(stream)
    if TROUBLES[trouble] is out_and_back:
        found["back_m"] = _back_m(stream, found["at"])
    version = __version__ if follower is None else follower.version
    return {"trouble": trouble, "version": version, **found}


def _back_m(stream: Stream, localized: Sequence[int]) -> float | None:
    """Metres from the end of the map until localized again, on the way back."""
    returns = int(np.flatnonzero(~is_covered(stream))[-1]) + 1
    travelled = geometry.distance_travelled(stream.truths)
    again = next((i for i in localized if i >= returns), None)
    return None if again is None else round(float(travelled[again] - travelled[returns]), 1)


def table(records: list[dict[str, Any]], of: str = "trouble") -> list[dict[str, Cell]]:
    """Return one row a trouble and version; ``of`` is the name of the first column."""
    rows: list[dict[str, Cell]] = []
    names = [(r["trouble"], r["version"]) for r in records]
    troubles = list(dict.fromkeys(trouble for trouble, _ in names))
    for trouble, version in sorted(dict.fromkeys(names), key=lambda name: troubles.index(name[0])):
        here = [r for r, name in zip(records, names, strict=True) if name == (trouble, version)]
        total = {
            key: sum(r[key] for r in here)
            for key in ("scans", "covered", "localized", "false_m", "degraded_false_m")
        }
        degraded, within = (sum(r[key] for r in here) for key in ("degraded", "degraded_within"))
        fixes = [fix for r in here for fix in r["first_fix"]]
        fixes += [r["back_m"] for r in here if "back_m" in r]
        fixes = [np.inf if fix is None else fix for fix in fixes]
        ms = sum(sum(r["scan_ms"]) + sum(r["query_ms"]) for r in here)
        localized = f"{total['localized']} of {total['covered']}"
        percent = 100 * total["localized"] / max(1, total["covered"])
        rows.append(
            {
                of: trouble,
                "version": version,
                "worlds": len(here),
                "localized, of scans near the mapped path": f"{localized} ({percent:.1f} %)",
                "false (m)": round(total["false_m"], 1),
                "degraded and false (m)": round(total["degraded_false_m"], 1),
                "degraded within three sigma": f"{within} of {degraded}",
                "first fix or return, median / 95 % (m)": spread(fixes, 95, 0),
                "a scan (ms)": f"{ms / max(1, total['scans']):.0f}",
            }
        )
    return rows


def report(records: list[dict[str, Any]], folder: Path | None) -> None:
    """Publish a table of the troubles, and one of kinds of world without any."""
    plain = [r | {"trouble": r["stream"]} for r in records if r["trouble"] == "none"]
    worst = [
        (r["trouble"], r["version"], f"{r['stream']} {r['seed']}", r["false_m"])
        for r in sorted(records, key=lambda r: -r["false_m"])
        if r["false_m"] > 0.0
    ]
    publish(
        folder,
        "Robots in trouble",
        Table.of(table(records)),
        Table.of(table(plain, "world"), title="No trouble, by kind of world"),
        Table(("trouble", "version", "world", "false (m)"), worst, title="Where poses are false"),
    )


def main() -> None:
    runner = Runner(__doc__, "troubles.jsonl", first_seed=68005, worlds=10, choosing=("troubles",))
    add = runner.options.add_argument
    add("--troubles", nargs="+", choices=TROUBLES, default=list(TROUBLES))
    add("--python", type=Path, help="interpreter of an environment that has another version")
    args = runner.parse()

    def recorded(task: tuple[int, str]) -> dict[str, Any] | None:
        seed, trouble = task
        world = world_of(ALIKE_KINDS, seed, 0.25 if trouble == QUARTER else 0.1)
        return record(world, trouble, args.python)

    tasks = itertools.product(runner.seeds, args.troubles)
    report(runner.run(recorded, tasks, ("seed", "trouble")), args.report)


if __name__ == "__main__":
    main()
