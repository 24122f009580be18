"""Read the output of ``segloc live``, during and after a run: poses and states by scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import SeglocError
from ...types import Float64, Pose
from .pictures import GREEN, ORANGE, PATH, RED, VIOLET, rgb
from .results import parse_records, pose_of
from .scene import MapScene

STATES, SO_FAR, NEWEST = "states.jsonl", "so_far.jsonl", "newest.npy"
"""All states of a finished run; during a run the states so far, and above-ground points of the
newest scan."""
COLOURS = {
    "localized": GREEN,
    "candidate": ORANGE,
    "degraded": ORANGE,
    "lost": VIOLET,
    "false": RED,
}
_ABOVE_M, _ARROW_M = 1.0, 8.0
_MAX_POINTS = 100_000


@dataclass(frozen=True)
class Moment:
    """State at one scan.

    Attributes
    ----------
    index : int
        Number of the scan.
    state : str
        lost, candidate, localized or degraded; "false" if the pose is known to be wrong.
    text : str
        Description in Markdown.
    T_map_base : (4, 4) float64 or None
    """

    index: int
    state: str
    text: str
    T_map_base: Pose | None


def follows(folder: Path) -> bool:
    """Return whether a folder is the output of ``segloc live``."""
    return (folder / STATES).is_file() or (folder / SO_FAR).is_file()


def read_moments(folder: Path) -> list[Moment]:
    """Read the states so far, except an incomplete last line.

    Raises
    ------
    SeglocError
        If it is another kind of folder, or a line is damaged.
    """
    for name in (SO_FAR, STATES, SO_FAR):  # STATES replaces SO_FAR at the end of a run
        file = folder / name
        try:
            lines = file.read_text("utf-8").split("\n")[:-1]
        except FileNotFoundError:
            continue
        except (OSError, ValueError) as error:
            raise SeglocError(f"{file}: cannot be read ({error})") from error
        return parse_records(_moment, lines, file)
    raise SeglocError(f"{folder}: no results of `segloc live --out`")


def _moment(record: Any) -> Moment:
    index, state = int(record["index"]), str(record["state"])
    if record.get("correct") is False:
        state = "false"
    text = (
        f"**scan {index}: {state}**\n\n{record['reason'] or 'no problems'}\n\n"
        f"- confidence {float(record['confidence']):.2f}\n"
        f"- {int(record['views'])} views agree\n"
        f"- {float(record['travelled_m']):.1f} m travelled"
    )
    if record["latency_ms"] is not None:
        text += f"\n- after {float(record['latency_ms']):.0f} ms"
    return Moment(index, state, text, pose_of(record["T_map_base"]))


def newest_points(folder: Path) -> Float64 | None:
    """Return above-ground points of the newest scan (N, 3), map frame; None if not stored."""
    try:
        points = np.load(folder / NEWEST, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    if points.ndim != 2 or points.shape[1] != 3 or len(points) > _MAX_POINTS:
        return None
    return np.asarray(points, dtype=np.float64)


def draw_moments(scene: MapScene, moments: Sequence[Moment], points: Float64 | None = None) -> None:
    """Draw the robot's trajectory by state, its pose and the newest scan.

    Stretches without poses are straight lines in the colour of their state.
    """
    scene.clear("robot")
    known = [(k, m.T_map_base) for k, m in enumerate(moments) if m.T_map_base is not None]
    if not known:
        return
    rows = [k for k, _ in known]
    at = scene.local(np.array([T[:3, 3] for _, T in known]) + [0.0, 0.0, _ABOVE_M])
    # Between two poses the state is that of the first scan after the earlier.
    states = [moments[k + 1].state for k in rows[:-1]] + [moments[rows[-1]].state]
    colours = np.array([rgb(COLOURS.get(state, PATH)) for state in states], np.uint8)
    steps = np.stack([at[:-1], at[1:]], axis=1)
    scene.lines("robot", "/robot/trajectory", steps, colours[:-1], 0.6)
    now, state = known[-1][1], states[-1]
    scene.arrows("robot", "/robot/now", [now], COLOURS.get(state, PATH), _ARROW_M)
    if points is not None:
        seen = np.tile(colours[-1], (len(points), 1))
        scene.points("robot", "/robot/cloud", scene.local(points), seen, 0.18)
