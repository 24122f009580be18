"""The contents of /diagnostics: one line for people, and figures."""

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


_ORDER = ("map", "jump", "points", "mount", "odometry", "gravity")
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
        level = Level.ERROR if first == "map" else Level.WARN
        nobody = robot.cloud_age_s is None and robot.publishers == 0 and first == "points"
        return level, f"{faults[first]}, which nobody publishes" if nobody else faults[first]
    level, message = _state(robot)
    if robot.map_fault:  # the map in use is older than its file
        return Level.WARN, f"{message}; the map in use stays: {robot.map_fault}"
    if robot.publishers is not None and robot.publishers > 1:
        topic = robot.settings.points_topic
        return Level.WARN, f"{message}; {topic} has {robot.publishers} publishers"
    return level, message


def _state(robot: Robot) -> tuple[Level, str]:
    if robot.trigger.resting:
        if robot.trigger.held is None:
            return Level.OK, "at rest: call ~/relocalize"
        return Level.OK, "localized, at rest"
    state = robot.state
    if state is None:
        return Level.WARN, "lost: nothing has come in"
    reason = state.reason if state.localized else robot.hint or state.reason
    return _LEVELS[state.status], f"{state.status}: {reason}" if reason else str(state.status)


def _values(robot: Robot) -> dict[str, str]:
    values: dict[str, str] = {"mode": robot.settings.mode, "trigger": robot.settings.trigger}
    values |= {f"missing {kind}": text for kind, text in robot.faults.items()}
    values |= {"map": robot.map_path, "map fault": robot.map_fault or robot.request_fault}
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
        "jumps": str(robot.jumps),
        "points": str(robot.points),
        "intake_ms": f"{robot.intake_ms:.1f}",
        "skipped": str(robot.skipped),
        "refused": str(robot.refused.total() + (0 if robot.core is None else robot.core.refused)),
    }
    values |= {f"refused: {reason}": str(count) for reason, count in robot.refused.items()}
    if robot.cloud_age_s is not None:
        values["cloud_age_s"] = f"{robot.cloud_age_s:.1f}"
    if robot.publishers is not None:
        values["points publishers"] = str(robot.publishers)
    if robot.time_notes:
        values["point times"] = robot.time_notes
    if (core := robot.core) is not None:
        values |= {"scans": str(core.scans), "dropped": str(core.dropped)}
    if (last := robot.last) is not None:
        values["last query"] = last.message or "believed"
        values["candidates"] = " ".join(f"{p:.3f}" for _, p in last.candidates)
        values |= {f"{stage}_ms": f"{ms:.1f}" for stage, ms in last.times_ms.items()}
    return values
