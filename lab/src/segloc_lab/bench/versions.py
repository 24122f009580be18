"""The times of this and of another installed version of segloc, in turns.

    python -m segloc_lab.bench.versions [--data FOLDER] [--against PYTHON] [--report FOLDER]

Both versions run in processes of their own, one scan after the other in turns, on one thread, and
report the processor time of each stage, of whole queries that are found in a map or refused, and
of building a map, aligning two sessions and driving on in a map with a query at every tenth scan.
Stages of whole queries are timed by the wall in versions whose localizer takes no clock.
``--against`` is the interpreter of an environment that has the other version of segloc. Scans of
``--data`` are real where it has them, else simulated.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from segloc import MemoryRecording, Recording, SegmentMap
from segloc.map import DEFAULT_METHOD
from segloc.types import Float32

from ..padding import padded_with_copies
from ..report import Cell, Table, publish, reporting
from .query import MAP_SEGMENTS, simulated_scene
from .stream import Stream, simulated_stream

OURS, OTHER = "this", "other"
COLUMNS = ("of", "stage", "this", "95 %", "other", "95 %", "ratio", "of 95 %")
_WORKER = Path(__file__).with_name("versions_worker.py")
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_BANDWIDTH_BYTES = 1 << 26
_SCANS, _QUERIES = 4, 12
_MAPPED, _ALIGNED_M = 60, 150.0
"""Scans of a map, and length of each session to align."""


class Worker:
    """One version of segloc, in a process of its own."""

    def __init__(self, python: str, process: subprocess.Popen[str]) -> None:
        self.python, self._process = python, process

    def measure(self, path: Path) -> dict[str, float]:
        """Milliseconds of each stage for the scan in a file."""
        assert self._process.stdin is not None and self._process.stdout is not None
        print(path, file=self._process.stdin, flush=True)
        line = self._process.stdout.readline()
        if not line:
            raise ChildProcessError(f"{self.python} {_WORKER.name} ended: is segloc installed?")
        pairs = (pair.rsplit("=", 1) for pair in line.strip().split(";"))
        return {stage: float(ms) for stage, ms in pairs}


@contextmanager
def worker(python: str, work: str, prior_map: Path | None = None) -> Iterator[Worker]:
    """Start a worker for one kind of work; its imports are those of its interpreter alone."""
    environment, pipe = {**os.environ, **_ONE_THREAD}, subprocess.PIPE
    where = [] if prior_map is None else [str(prior_map)]
    command = [python, "-I", str(_WORKER), work, *where]
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment) as process:
        yield Worker(python, process)
        assert process.stdin is not None
        process.stdin.close()


Times = dict[str, list[float]]
"""Milliseconds of each stage, run by run."""


def in_turns(
    pythons: dict[str, str],
    work: str,
    inputs: Sequence[Float32 | Sequence[Recording]],
    repeats: int,
    prior_map: SegmentMap | None = None,
) -> dict[str, Times]:
    """Time work on scans, or on groups of recordings; versions in turns, input by input."""
    times: dict[str, Times] = {name: {} for name in pythons}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        where = None if prior_map is None else folder / "a.segmap"
        if prior_map is not None and where is not None:
            prior_map.save(where)
        workers = {
            name: stack.enter_context(worker(each, work, where)) for name, each in pythons.items()
        }
        paths = [_written(folder / str(i), each) for i, each in enumerate(inputs)]
        for path in paths:
            for each in workers.values():
                each.measure(path)
        for _ in range(repeats):
            for path in paths:
                for name, each in workers.items():
                    for stage, ms in each.measure(path).items():
                        times[name].setdefault(stage, []).append(ms)
    return times


def _written(path: Path, given: Float32 | Sequence[Recording]) -> Path:
    """Write an input of a worker; return its file."""
    if isinstance(given, np.ndarray):
        np.save(path.with_suffix(".npy"), given)
        return path.with_suffix(".npy")
    columns: dict[str, Any] = {}
    for k, recording in enumerate(given):
        scans = [recording.scan(i) for i in range(len(recording))]
        columns |= {
            f"{k}/points": np.concatenate([scan.points for scan in scans]),
            f"{k}/offsets": np.cumsum([0, *map(len, scans)]),
            f"{k}/poses": recording.poses,
            f"{k}/stamps": recording.indices if recording.stamps is None else recording.stamps,
        }
    np.savez(path.with_suffix(".npz"), **columns)
    return path.with_suffix(".npz")


def copy_gb_s() -> float:
    """The rate at which this machine copies memory, bytes read and written, GB/s."""
    source = np.zeros(_BANDWIDTH_BYTES, np.uint8)
    target = np.empty_like(source)
    from .harness import interleaved

    ms = interleaved({"copy": lambda: np.copyto(target, source)}, 1, 7)["copy"]
    return 2.0 * _BANDWIDTH_BYTES / ms / 1e6


def _simulated(name: str, firings: int | None) -> Callable[[], list[Float32]]:
    def scans() -> list[Float32]:
        from ..simulation import SENSORS, Route, simulate_session, town

        lidar = SENSORS[name]() if firings is None else SENSORS[name](firings)
        world = town(0, size_m=200.0)
        junctions = tuple(world.roads.walk(np.random.default_rng(0), [0], 100.0, avoid=[]))
        drive = simulate_session(world, 0, Route(junctions, length_m=100.0), lidar, 0)
        chosen = np.linspace(0, len(drive) - 1, _SCANS).astype(int)
        return [drive.scan(int(i)).points for i in chosen]

    return scans


SIMULATED = {
    "HDL-64E": _simulated("hdl64e", 1875),
    "OS1-128": _simulated("os1-128", 1024),
    "VLP-16": _simulated("vlp16", 1800),
    "MID-360": _simulated("mid360", None),
}
REAL = {
    "HDL-64E": "kitti00/scans",
    "VLP-16": "vlp16_corridor/scans",
    "MID-360": "mid360_lab/0618/scans",
}
"""Where ``../shared/data`` has scans of a sensor; those of the MID-360 are crops of a map."""


def sensors(data: Path | None) -> dict[str, list[Float32]]:
    """A few scans of each sensor."""
    found: dict[str, list[Float32]] = {}
    for name, simulated in SIMULATED.items():
        files = sorted((data / REAL[name]).glob("*.laz")) if data and name in REAL else []
        if not files:
            found[f"{name}, simulated"] = simulated()
            continue
        from segloc.io import read_scan

        chosen = np.linspace(0, len(files) - 1, _SCANS).astype(int)
        found[f"{name}, {REAL[name]}"] = [read_scan(files[i]).points for i in chosen]
    return found


def scene_of(data: Path | None, segments: int) -> tuple[SegmentMap, list[Float32]]:
    """Return a map with a number of segments, and single scans of it and of other places."""
    if data and (data / "kitti00").is_dir():
        from .kitti_query import kitti_scene

        scene = kitti_scene(data / "kitti00", DEFAULT_METHOD, _QUERIES)
    else:
        scene = simulated_scene(1, queries=_SCANS)
    queries = [*(scan for scan, _ in scene.queries), *scene.elsewhere]
    return padded_with_copies(scene.prior_map, segments), [query.points for query in queries]


def drives(data: Path | None) -> tuple[Recording, list[Recording], Stream]:
    """A drive to map, two sessions to align, and a stream in a map."""
    from ..simulation import Route, hdl64e, simulate_session, town

    world = town(0, size_m=200.0)
    junctions = tuple(world.roads.walk(np.random.default_rng(0), [0], _ALIGNED_M, avoid=[]))
    route, again = (Route(junctions, aside, length_m=_ALIGNED_M) for aside in (0.0, 0.3))
    sessions: list[Recording] = [
        simulate_session(world, k, each, hdl64e(900), k).with_odometry()
        for k, each in enumerate((route, again))
    ]
    stream = simulated_stream("hdl64e", 1875)
    if data and (data / "kitti00").is_dir():
        from .. import kitti00

        scans = kitti00.mapped(data / "kitti00", "single")
        poses = kitti00.poses_of(scans)[:_MAPPED]
        drive: Recording = MemoryRecording([scans.scan(i) for i in range(len(poses))], poses)
    else:
        drive = simulate_session(world, 0, route, hdl64e(1875), 0)
    return drive, sessions, stream


def rows_of(name: str, found: dict[str, Times]) -> Iterator[Sequence[Cell]]:
    """Median and 95th percentile of each stage, and their ratios to the other version's."""
    for stage, ms in found[OURS].items():
        ours = np.percentile(ms, (50, 95))
        cells = [f"{each:.2f}" for each in ours]
        if stage in found.get(OTHER, {}):
            other = np.percentile(found[OTHER][stage], (50, 95))
            cells += [f"{each:.2f}" for each in (*other, *(ours / other))]
        yield (name, stage, *cells, *[None] * (6 - len(cells)))


def main() -> None:
    parsed = reporting(__doc__)
    parsed.add_argument("--segments", type=int, default=MAP_SEGMENTS, help="of the map")
    parsed.add_argument("--data", type=Path)
    parsed.add_argument("--against", metavar="PYTHON", help="interpreter of the other version")
    parsed.add_argument("--repeats", type=int, default=20)
    parsed.add_argument("--long-repeats", type=int, default=3, help="of what takes seconds")
    options = parsed.parse_args()
    pythons = {OURS: sys.executable}
    if options.against:
        pythons[OTHER] = options.against
    rate = copy_gb_s()
    rows: list[Sequence[Cell]] = []
    for name, scans in sensors(options.data).items():
        points = statistics.median(len(each) for each in scans)
        bound_ms = 12.0 * points / rate / 1e6
        rows.append((name, f"one pass over {points:.0f} points", f"{bound_ms:.3f}", *[None] * 5))
        rows.extend(rows_of(name, in_turns(pythons, "stages", scans, options.repeats)))
    prior_map, queries = scene_of(options.data, options.segments)
    found = in_turns(pythons, "query", queries, options.repeats, prior_map)
    rows.extend(rows_of(f"query, {len(prior_map)} segments", found))
    drive, sessions, stream = drives(options.data)
    streamed = MemoryRecording(stream.scans)
    for name, work, given, place in (
        (f"{len(drive)} scans", "build", [drive], None),
        (f"2 sessions of {_ALIGNED_M:.0f} m", "align", sessions, None),
        (f"{len(streamed)} scans", "stream", [streamed], stream.prior_map),
    ):
        found = in_turns(pythons, work, [given], options.long_repeats, place)
        rows.extend(rows_of(name, found))
    note = f"Milliseconds of processor time of one thread. Memory is copied at {rate:.1f} GB/s."
    publish(options.report, "Two versions in turns", Table(COLUMNS, rows, note))


if __name__ == "__main__":
    main()
