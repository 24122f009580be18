"""Scans and odometry as a robot on the plaza has them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from segloc import Scan, geometry
from segloc.live import LiveCore, State
from segloc.types import Float64, Pose

from .plaza import Plaza

T_MAP_ODOM = geometry.yaw_transform(1.1, (40.0, -7.0, 0.4))


@dataclass(frozen=True)
class Event:
    """A scan, or a pose of the odometry."""

    stamp: float
    scan: Scan | None = None
    T_odom_base: Pose | None = None


def walked(
    plaza: Plaza,
    count: int,
    *,
    begin: tuple[float, float] = (-14.0, 1.0),
    step: float = 2.0,
    start_s: float = 100.0,
    T_map_odom: Pose = T_MAP_ODOM,
    carried: Pose | None = None,
    every_s: float = 1.0,
) -> Iterator[tuple[list[Event], Pose]]:
    """A scan every so often, with odometry before and behind it, and the true pose.

    With ``carried`` the robot is kidnapped: moved by that, in the map.
    """
    T_odom_map = geometry.inverse(T_map_odom)
    moved = np.eye(4) if carried is None else carried
    for k in range(count):
        stamp = start_s + every_s * k
        poses = [_at(begin, k + dt, step) for dt in (-0.2, 0.0, 0.2)]
        truth = moved @ poses[1]
        scan = plaza.scan(truth, posed=False, seed=k)
        before, _, behind = (T_odom_map @ T for T in poses)
        yield (
            [
                Event(stamp - 0.2 * every_s, T_odom_base=before),
                Event(stamp, Scan(scan.points)),
                Event(stamp + 0.2 * every_s, T_odom_base=behind),
            ],
            truth,
        )


def _at(begin: tuple[float, float], k: float, step: float) -> Pose:
    return geometry.yaw_transform(0.02 * k, (begin[0] + step * k, begin[1] + 0.1 * k, 1.8))


def put(receiver: Any, event: Event) -> Any:
    """Hand an event to a core, or to what has one."""
    if event.scan is not None:
        return receiver.add_scan(event.scan, event.stamp)
    return receiver.add_odometry(event.stamp, event.T_odom_base)


def feed(core: LiveCore, events: list[Event]) -> list[State]:
    """States after some events, each query made as soon as it is due."""
    states: list[State] = []
    for event in events:
        states += put(core, event)
        if (requested := core.due()) is not None:
            states.append(core.answer(requested, core.ask(requested)))
    return states


def off_m(T: Pose, truth: Pose) -> float:
    """How far a pose is off."""
    return float(np.linalg.norm((geometry.inverse(truth) @ T)[:3, 3]))


def error_m(state: State, truth: Float64) -> float:
    """How far a state's pose is off; infinite where it has none."""
    return float("inf") if state.T_map_base is None else off_m(state.T_map_base, truth)
