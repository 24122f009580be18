"""What ``segloc live`` leaves behind, while it runs and after: where the robot was, how sure."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import SeglocError
from ..types import Float64, Pose
from .pictures import GREEN, ORANGE, PATH, RED, rgb
from .scene import MapScene

STATES, SO_FAR, NEWEST = "states.jsonl", "so_far.jsonl", "newest.npy"
"""All states once it is done; until then those so far, and what stands in the newest scan."""
COLOURS = {
    "lost": rgb(RED),
    "candidate": rgb(ORANGE),
    "degraded": rgb(ORANGE),
    "localized": rgb(GREEN),
}
_ABOVE_M = 1.0
_MAX_POINTS = 100_000


@dataclass(frozen=True)
class Moment:
    """What was said when a scan was taken.

    Attributes
    ----------
    index : int
        Number of the scan.
    state : str
        lost, candidate, localized or degraded.
    said : str
        In Markdown.
    T_map_base : (4, 4) float64 or None
    """

    index: int
    state: str
    said: str
    T_map_base: Pose | None


def follows(folder: Path) -> bool:
    """Whether a folder is one of ``segloc live``."""
    return (folder / STATES).is_file() or (folder / SO_FAR).is_file()


def read_moments(folder: Path) -> list[Moment]:
    """All that was said so far; a last line that is being written is left out.

    Raises
    ------
    SeglocError
        If it is no such folder, or a line is damaged.
    """
    for name in (SO_FAR, STATES, SO_FAR):  # the first gives way to the second at the end
        file = folder / name
        try:
            lines = file.read_text("utf-8").split("\n")[:-1]
        except FileNotFoundError:
            continue
        except OSError as error:
            raise SeglocError(f"{file}: cannot be read ({error.strerror or error})") from error
        return [_moment(file, number, line) for number, line in enumerate(lines, 1)]
    raise SeglocError(f"{folder}: no results of `segloc live --out`")


def _moment(file: Path, number: int, line: str) -> Moment:
    try:
        record = json.loads(line)
        pose, state = record["T_map_base"], str(record["state"])
        T = None if pose is None else np.array(pose, dtype=np.float64).reshape(4, 4)
        said = (
            f"**scan {int(record['index'])}: {state}**\n\n{record['reason'] or 'no doubt'}\n\n"
            f"- confidence {float(record['confidence']):.2f}\n"
            f"- {int(record['views'])} views agree\n"
            f"- {float(record['travelled_m']):.1f} m travelled"
        )
        if record["latency_ms"] is not None:
            said += f"\n- said after {float(record['latency_ms']):.0f} ms"
        return Moment(int(record["index"]), state, said, T)
    except (ValueError, KeyError, TypeError) as error:
        raise SeglocError(f"{file}: line {number}: damaged ({error})") from error


def newest_points(folder: Path) -> Float64 | None:
    """What stands in the newest scan, (N, 3), in the map's frame; None where nothing is kept."""
    try:
        points = np.load(folder / NEWEST, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    if points.ndim != 2 or points.shape[1] != 3 or len(points) > _MAX_POINTS:
        return None
    return np.asarray(points, dtype=np.float64)


def draw_moments(scene: MapScene, moments: Sequence[Moment], points: Float64 | None = None) -> None:
    """The robot's path so far by state, where it is now, and what it sees, in place of before."""
    scene.clear("robot")
    placed = [(m.T_map_base, m.state) for m in moments if m.T_map_base is not None]
    if not placed:
        return
    lift = np.array([0.0, 0.0, _ABOVE_M])
    path = scene.local(np.array([T[:3, 3] + lift for T, _ in placed]))
    colours = np.array([COLOURS.get(state, rgb(PATH)) for _, state in placed], dtype=np.uint8)
    scene.points("robot", "/robot/path", path[:-1], colours[:-1], 0.5)
    scene.points("robot", "/robot/now", path[-1:], colours[-1:], 1.5)
    if points is not None:
        seen = np.tile(colours[-1], (len(points), 1))
        scene.points("robot", "/robot/cloud", scene.local(points), seen, 0.18)
