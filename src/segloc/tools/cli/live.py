"""``segloc live``"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from ...errors import ConfigError
from ...system.text import number, quantity
from . import options
from .console import note, progress, say, table

if TYPE_CHECKING:
    from ...live import State
    from ...live.replay import Replay
    from ...types import Recording as Scans


_DEADLINE_MS = 1000.0
_EVERY_S = 1.0
_VOXEL_M = 0.3


def live(
    sequence: options.Recording,
    prior_map: Annotated[str, typer.Option("--map", metavar="MAP.segmap", help="The prior map.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Output folder.")],
    poses: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Odometry, TUM or KITTI, in any frame.",
            show_default="the recording's",
        ),
    ] = None,
    select: options.Select = None,
    truth: options.Truth = None,
    tolerance_m: options.Metres = 2.0,
    tolerance_deg: options.Degrees = 10.0,
    rate: Annotated[
        float,
        typer.Option(
            min=0,
            metavar="FACTOR",
            help="Speed: 1 replays in real time and drops late scans; 0 waits for every scan.",
        ),
    ] = 0.0,
    every: Annotated[
        float, typer.Option(min=0, metavar="METRES", help="Distance between queries.")
    ] = 10.0,
    pose_file: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="File of the last pose: checked first, then kept up to date.",
            show_default="none",
        ),
    ] = None,
    topic: options.Topic = None,
    deskew: options.Deskew = True,
    odometry: options.Odometry = False,
    level: options.Level = False,
    config: options.ConfigFile = None,
    weights: options.SameWeights = None,
    threads: options.Threads = 0,
) -> None:
    """Replay a recording through the online localizer, scan by scan.

    Only the motion between poses is used, never where they are. Without poses, or with --odometry,
    the motion is computed scan by scan (KISS-ICP). Writes poses.tum, states.jsonl and
    summary.json; `segloc view MAP DIR` follows it meanwhile.
    """
    from ...live import PoseKeeper
    from ...live.replay import correct, play, summary
    from ...tiles import open_map
    from ..datasets import NO_POSES
    from .recording import levelled_poses, open_recording, place_of_sensor, true_poses
    from .results import check_folder, map_facts, write_together

    check_folder(out)
    if odometry and poses is not None:
        raise ConfigError("--odometry and --poses exclude each other")
    localizer = options.open_localizer(open_map(prior_map), config, threads, weights)
    local = localizer.config.local_cloud
    poses = Path(NO_POSES) if odometry else poses
    recording: Scans = open_recording(
        sequence, poses, select, topic=topic, deskew=deskew, local=local
    )
    if recording.poses is None:
        note("odometry from the scans (KISS-ICP)")
    recording = levelled_poses(recording, local, level)
    truths = true_poses(recording, sequence, truth, topic, place_of_sensor(local.mount))
    keeper = None if pose_file is None else PoseKeeper(pose_file)
    with SoFar(out, recording, clouds=not rate) as so_far, progress("Following") as update:
        tell = _teller(recording)

        def on_state(position: int, state: State) -> None:
            tell(position, state)
            so_far.add(position, state)

        played = play(localizer, recording, _settings(every, rate), rate, on_state, update, keeper)
    for line in [] if keeper is None else keeper.notes:
        note(line)
    if recording.poses is None and played.jumps:
        note(
            f"odometry from the scans was lost {quantity(played.jumps, 'times')}: record scans at "
            "shorter distances, or pass poses"
        )
    facts: dict[str, Any] = {
        "recording": recording.name,
        "map": options.map_name(prior_map),
        "rate": rate,
    }
    facts |= summary(played, truths, tolerance_m, tolerance_deg)
    facts |= map_facts(localizer.prior_map)
    fits = correct(played, truths, tolerance_m, tolerance_deg)
    write_together(out, _contents(recording, played, facts, fits))
    _show(facts, f"{recording.name} in {options.map_name(prior_map)}")
    if played.fault is not None:
        raise played.fault


def _settings(every_m: float, rate: float) -> Any:
    """Return the settings; in real time a query is limited to about a second."""
    from ...live import LiveConfig

    settings = LiveConfig(deadline_ms=_DEADLINE_MS if rate else None)
    tracker = settings.tracker.model_copy(update={"every_m": every_m})
    return settings.model_copy(update={"tracker": tracker})


def _teller(recording: Scans) -> Callable[[int, State], None]:
    """Return a callback that prints a line whenever the state changes."""
    last: str | None = None

    def on_state(position: int, state: State) -> None:
        nonlocal last
        if state.status.value == last:
            return
        last = state.status.value
        T = state.T_map_base
        where = "" if T is None else f" at {T[0, 3]:.1f}, {T[1, 3]:.1f}"
        why = f": {state.reason}" if state.reason else ""
        path = f"{state.travelled_m:.1f} m"
        say(f"scan {recording.indices[position]}, {path}: {state.status}{where}{why}")

    return on_state


def _contents(
    recording: Scans, played: Replay, facts: dict[str, Any], fits: Sequence[bool | None]
) -> dict[str, bytes]:
    lines = []
    for position, correct in zip(map(int, played.positions), fits, strict=True):
        state = record(recording, position, played.states[position]) | {"correct": correct}
        lines.append(json.dumps(state, allow_nan=False) + "\n")
    return {
        "poses.tum": _poses(recording, played),
        "states.jsonl": "".join(lines).encode(),
        "summary.json": (json.dumps(facts, indent=2, allow_nan=False) + "\n").encode(),
    }


def _poses(recording: Scans, played: Replay) -> bytes:
    """Return T_map_sensor by stamp, or else by scan number."""
    import numpy as np

    from .results import tum_bytes

    found = {
        position: T
        for position in map(int, played.positions)
        if (T := played.states[position].T_map_base) is not None
    }
    rows, stamps = np.array(list(found), dtype=np.int64), recording.stamps
    track = np.array(list(found.values()), dtype=np.float64).reshape(-1, 4, 4)
    return tum_bytes(recording.indices[rows], None if stamps is None else stamps[rows], track)


def _show(facts: dict[str, Any], title: str) -> None:
    from ..batch.report import error_rows

    rows = [
        ("scans", f"{facts['scans']}, {facts['dropped']} dropped"),
        ("travelled", number(facts["travelled_m"], "m", 1)),
        ("localized", number(100 * facts["localized_share"], "%", 1)),
        ("first fix after", number(facts["first_fix_m"], "m", 1)),
    ]
    if facts["false_m"] is not None:
        rows.append(("false track", number(facts["false_m"], "m", 1)))
        rows += error_rows(facts)
    for name, key in (("a scan", "latency_ms"), ("a query or check", "query_ms")):
        times = facts[key]
        pair = f"{number(times['p50'], 'ms', 1)} / {number(times['p99'], 'ms', 1)}"
        rows.append((f"time of {name}, median / 99 %", pair))
    table(title, ("", ""), rows)


class SoFar:
    """Store states and the newest scan in a folder during a replay, for `segloc view`.

    Parameters
    ----------
    out : path
        Created with the first state.
    recording : Recording
    clouds : bool
        True if the thread that adds states may read scans.
    """

    def __init__(self, out: Path, recording: Scans, clouds: bool = True) -> None:
        from ..inspect.following import NEWEST, SO_FAR

        self._states, self._newest = out / SO_FAR, out / NEWEST
        self._recording, self._clouds = recording, clouds
        self._stream: TextIO | None = None
        self._last = -math.inf

    def __enter__(self) -> SoFar:
        return self

    def __exit__(self, *_: object) -> None:
        if self._stream is not None:
            self._stream.close()
            for file in (self._states, self._newest):
                file.unlink(missing_ok=True)

    def add(self, position: int, state: State) -> None:
        """Add a state; at most once a second also the points of its scan."""
        if self._stream is None:
            self._states.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self._states.open("w", encoding="utf-8")
        self._stream.write(json.dumps(record(self._recording, position, state)) + "\n")
        self._stream.flush()
        if self._clouds and time.monotonic() - self._last > _EVERY_S:
            self._last = time.monotonic()
            self._keep(position, state)

    def _keep(self, position: int, state: State) -> None:
        import numpy as np

        from ... import _native, geometry
        from ...system.files import replacing

        T = state.T_map_base
        if T is None:
            self._newest.unlink(missing_ok=True)
            return
        points = geometry.transform(T, self._recording.scan(position).points)
        origin = points.mean(axis=0) if len(points) else np.zeros(3)
        local = np.ascontiguousarray(points - origin, dtype=np.float32)
        thinned = _native.voxel_grid(local, _VOXEL_M).astype(np.float64) + origin
        with replacing(self._newest) as stream:
            np.save(stream, thinned)


def record(recording: Scans, position: int, state: State) -> dict[str, Any]:
    """Return a state as JSON values, with the number and stamp of its scan."""
    return {
        "index": int(recording.indices[position]),
        **state.record(),
        "stamp": None if recording.stamps is None else float(recording.stamps[position]),
        "correct": None,
    }
