"""What /diagnostics says: one line for people, and figures."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from segloc.live import Status

from .robot import Robot


class Level(IntEnum):
    """diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Diagnosis:
    """One diagnostic_msgs/DiagnosticStatus.

    Attributes
    ----------
    level : Level
    message : str
        The state, and why it is no better.
    values : dict of str to str
    """

    level: Level
    message: str
    values: dict[str, str]


_ORDER = ("map", "points", "mount", "odometry", "gravity", "jump")
_LEVELS = {
    Status.LOCALIZED: Level.OK,
    Status.DEGRADED: Level.WARN,
    Status.CANDIDATE: Level.WARN,
    Status.LOST: Level.WARN,
}


def diagnose(robot: Robot) -> Diagnosis:
    """How a robot is doing."""
    level, message = _summary(robot)
    return Diagnosis(level, message, _values(robot))


def _summary(robot: Robot) -> tuple[Level, str]:
    faults = robot.faults
    first = next((kind for kind in _ORDER if kind in faults), None)
    if first is not None:
        return Level.ERROR if first == "map" else Level.WARN, faults[first]
    if robot.trigger.resting:
        if robot.trigger.held is None:
            return Level.OK, "at rest: call ~/relocalize"
        return Level.OK, "localized, at rest"
    state = robot.state
    if state is None:
        return Level.WARN, "lost: nothing has come in"
    why = f": {state.reason}" if state.reason else ""
    return _LEVELS[state.status], f"{state.status}{why}"


def _values(robot: Robot) -> dict[str, str]:
    values: dict[str, str] = {"mode": robot.settings.mode, "trigger": robot.settings.trigger}
    values |= {f"missing {kind}": text for kind, text in robot.faults.items()}
    if (state := robot.state) is not None:
        values |= {
            "status": state.status.value,
            "reason": state.reason,
            "confidence": f"{state.confidence:.3f}",
            "views": str(state.views),
            "travelled_m": f"{state.travelled_m:.1f}",
            "stamp": f"{state.stamp:.3f}",
        }
    values |= {
        "fixes": str(robot.fixes),
        "points": str(robot.points),
        "intake_ms": f"{robot.intake_ms:.1f}",
    }
    if (core := robot.core) is not None:
        counts = {"scans": core.scans, "dropped": core.dropped, "refused": core.refused}
        values |= {name: str(count) for name, count in counts.items()}
    if (last := robot.last) is not None:
        values["last query"] = last.message or "believed"
        values["candidates"] = " ".join(f"{p:.3f}" for _, p in last.candidates)
        values |= {f"{stage}_ms": f"{ms:.1f}" for stage, ms in last.times_ms.items()}
    return values
