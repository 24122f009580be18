"""The contents of /diagnostics, one line for people and figures, and the state for programs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

from segloc.live import StateReason, Status

from .robot import Robot


class Level(IntEnum):
    """diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Diagnosis:
    """One diagnostic_msgs/DiagnosticStatus; its message is the state, and why it is no better."""

    level: Level
    message: str
    values: dict[str, str]


class StateStatus(IntEnum):
    """Constants of segloc_msgs/State."""

    LOST = 0
    CANDIDATE = 1
    DEGRADED = 2
    LOCALIZED = 3
    INACTIVE = 4


class TfState(IntEnum):
    """Constants of segloc_msgs/State: which map -> odom is broadcast."""

    NONE = 0
    CURRENT = 1
    KEPT = 2


@dataclass(frozen=True)
class RobotState:
    """The contents of a segloc_msgs/State, whose file describes them."""

    stamp: float
    status: StateStatus
    at_rest: bool
    reason: str
    confidence: float
    map_url: str
    map_to_odom: TfState

    @property
    def localized(self) -> bool:
        """Whether there is a pose."""
        return self.status in (StateStatus.LOCALIZED, StateStatus.DEGRADED)

    def is_news_after(self, last: RobotState) -> bool:
        """Return whether the state differs from the last one published.

        Another confidence alone is news by the next stamp, so that each stamp has one message.
        """
        confidence = last.confidence if self.stamp == last.stamp else self.confidence
        return replace(self, confidence=confidence) != replace(last, stamp=self.stamp)


def robot_state(robot: Robot, active: bool) -> RobotState:
    """Return the state of a robot; ``active``: whether the node takes input."""
    current = robot.pose_state
    status, map_to_odom = StateStatus.LOST, TfState.NONE
    if current is not None:
        status = StateStatus[current.status.name]
    is_given = robot.T_map_odom is not None and not robot.lacks_odometry
    if robot.settings.broadcasts_tf and is_given:
        map_to_odom = TfState.CURRENT
    elif robot.keeps_tf:
        map_to_odom = TfState.KEPT
    reason = _fault(robot) or _reason(robot)
    if not active:
        status, map_to_odom, reason = StateStatus.INACTIVE, TfState.NONE, "inactive"
    return RobotState(
        robot.stamp,
        status,
        robot.trigger.resting,
        reason,
        0.0 if current is None else round(current.confidence, 2),
        robot.maps.path,
        map_to_odom,
    )


_LATE_S = 1.0
_ORDER = ("map", "jump", "points", "mount", "odometry", "gravity")
_LEVELS = {
    Status.LOCALIZED: Level.OK,
    Status.DEGRADED: Level.WARN,
    Status.CANDIDATE: Level.WARN,
    Status.LOST: Level.WARN,
}


def diagnose(robot: Robot) -> Diagnosis:
    """Return the diagnosis of a robot."""
    level, message = _summary(robot)
    return Diagnosis(level, message, _values(robot))


def _summary(robot: Robot) -> tuple[Level, str]:
    if fault := _fault(robot):
        is_error = "map" in robot.faults and robot.maps.fault and not robot.maps.progress
        return Level.ERROR if is_error else Level.WARN, fault
    level, message = _state(robot)
    if robot.keeps_tf:
        message = f"{message}; the last map -> odom is kept"
    if robot.maps.progress:
        return Level.WARN, f"{message}; {robot.maps.progress}"
    if robot.maps.fault:  # the map in use is older than its file
        return Level.ERROR, f"{message}; the map in use stays: {robot.maps.fault}"
    if robot.behind_s > _LATE_S:
        return Level.WARN, (
            f"{message}; input is processed {robot.behind_s:.1f} s late: the node lacks processor "
            "time"
        )
    if robot.publishers is not None and robot.publishers > 1:
        topic = robot.settings.points_topic
        return Level.WARN, f"{message}; {topic} has {robot.publishers} publishers"
    return level, message


def _fault(robot: Robot) -> str:
    """Return the first fault that keeps poses from being computed; "" if there is none."""
    faults = robot.faults
    first = next((kind for kind in _ORDER if kind in faults), None)
    if first is None:
        return ""
    nobody = robot.cloud_age_s is None and robot.publishers == 0 and first == "points"
    return f"{faults[first]}, which nobody publishes" if nobody else faults[first]


def _reason(robot: Robot) -> str:
    """Return why a robot without a fault is not localized, or only degraded; "" otherwise."""
    state = robot.pose_state
    if state is None:
        return "at rest: call ~/relocalize" if robot.trigger.resting else "no data received yet"
    if robot.trigger.resting and robot.lacks_odometry:
        return str(StateReason.NO_ODOMETRY)
    return state.reason if state.localized else robot.hint or state.reason


def _state(robot: Robot) -> tuple[Level, str]:
    state, reason = robot.pose_state, _reason(robot)
    if robot.trigger.resting:
        if state is not None and robot.lacks_odometry:
            return Level.WARN, f"localized, at rest: {reason}"
        return Level.OK, reason if state is None else "localized, at rest"
    if state is None:
        return Level.WARN, f"lost: {reason}"
    return _LEVELS[state.status], f"{state.status}: {reason}" if reason else str(state.status)


def _values(robot: Robot) -> dict[str, str]:
    values: dict[str, str] = {"mode": robot.settings.mode, "trigger": robot.settings.trigger}
    values |= {f"missing {kind}": text for kind, text in robot.faults.items()}
    values |= {"map": robot.maps.path, "map fault": robot.maps.fault or robot.maps.request_fault}
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
        "behind_s": f"{robot.behind_s:.1f}",
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
        values["unused heights"] = str(core.unused_heights)
    if (last := robot.last) is not None:
        values["last query"] = "accepted" if last.localized else last.message
        values["candidates"] = " ".join(f"{place.probability:.3f}" for place in last.places)
        values |= {f"{stage}_ms": f"{ms:.1f}" for stage, ms in last.times_ms.items()}
    return values
