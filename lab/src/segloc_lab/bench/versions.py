"""Work timed in processes of their own: by this version of segloc, and by another in turns."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from segloc.errors import ConfigError, SeglocError

from ..report import Cell, Table
from .harness import OURS, copy_gb_s, thread_variables
from .works import Input, Work

OTHER = "other"
COLUMNS = ("of", "stage", "this", "95 %", "other", "95 %", "ratio", "of 95 %")
BUDGET_S = 20.0
"""Time after which work is not repeated any more."""
_MIN_ROUNDS = 2
_WORKER = Path(__file__).with_name("worker.py")
_BESIDE = """\
import runpy, sys
sys.path[:0] = {!r}
del sys.argv[0]
runpy.run_path(sys.argv[0], run_name="__main__")"""

Command = list[str]
"""The beginning of the command line of a worker."""


@contextmanager
def commands(against: Path | None) -> Iterator[dict[str, Command]]:
    """Yield the commands that start workers of this and of another version.

    Parameters
    ----------
    against : Path, optional
        The other version: the interpreter of an environment that has it, or its wheel, which is
        unpacked and run with the packages of this environment.

    Raises
    ------
    ConfigError
        If there is no such file.
    """
    isolated = ["-I", str(_WORKER)]
    found = {OURS: [sys.executable, *isolated]}
    if against is not None and not against.is_file():
        raise ConfigError(f"--against {against}: no such file; pass an interpreter or a wheel")
    with tempfile.TemporaryDirectory() as folder:
        if against is not None and against.suffix == ".whl":
            with zipfile.ZipFile(against) as wheel:
                wheel.extractall(folder)
            beside = _BESIDE.format([folder, *sys.path])
            found[OTHER] = [sys.executable, "-I", "-S", "-c", beside, str(_WORKER)]
        elif against is not None:
            found[OTHER] = [str(against), *isolated]
        yield found


Measure = Callable[[Path], dict[str, Any]]
"""Returns the version, the milliseconds of each stage for a file, and counts of answers."""


@contextmanager
def worker(command: Command, work: Work, threads: int, prior_map: Path | None) -> Iterator[Measure]:
    """Start a version of segloc for one kind of work, in a process of its own.

    Its imports are those of its interpreter alone.
    """
    environment, pipe = {**os.environ, **thread_variables(threads)}, subprocess.PIPE
    where = [] if prior_map is None else ["--map", str(prior_map)]
    if work.tile_m is not None:
        where += ["--tiles", str(work.tile_m)]
    given = [*command, work.kind, "--threads", str(threads), *where]
    with subprocess.Popen(given, stdin=pipe, stdout=pipe, text=True, env=environment) as process:
        stdin, stdout = process.stdin, process.stdout
        assert stdin is not None and stdout is not None

        def measure(path: Path) -> dict[str, Any]:
            with suppress(BrokenPipeError):
                print(path, file=stdin, flush=True)
            line = stdout.readline()
            if not line:
                raise SeglocError(f"{command[0]}: the worker ended; is segloc installed there?")
            found: dict[str, Any] = json.loads(line)
            return found

        try:
            yield measure
        finally:
            with suppress(BrokenPipeError):  # of a worker that ended
                stdin.close()


@dataclass
class Measured:
    """Times and answers of one version.

    Attributes
    ----------
    version : str or None
    ms : dict of str to list of float
        Of each stage, run by run.
    counts : Counter of str
        Answers to all inputs, by kind.
    """

    version: str | None = None
    ms: defaultdict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    counts: Counter[str] = field(default_factory=Counter)

    def median(self, stage: str) -> float:
        """Return the median of a stage [ms]; NaN if it never ran."""
        return float(np.median(self.ms.get(stage, [np.nan])))


def in_turns(
    versions: Mapping[str, Command], work: Work, threads: int, repeats: int
) -> dict[str, Measured]:
    """Time work; versions in turns, input by input, after a round that warms up."""
    measured = {name: Measured() for name in versions}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        where = None if work.prior_map is None else folder / "a.segmap"
        if work.prior_map is not None and where is not None:
            work.prior_map.save(where)
        workers = {
            name: stack.enter_context(worker(command, work, threads, where))
            for name, command in versions.items()
        }
        paths = [write(folder / f"{i}.npz", each) for i, each in enumerate(work.inputs)]
        for path in paths:
            for name, measured_by in workers.items():
                found = measured_by(path)
                measured[name].version = found["version"]
                measured[name].counts.update(found["counts"])
        start = time.monotonic()
        for done in range(repeats):
            if done >= _MIN_ROUNDS and time.monotonic() - start > BUDGET_S:
                break
            for path in paths:
                for name, measured_by in workers.items():
                    for stage, ms in measured_by(path)["ms"].items():
                        measured[name].ms[stage].append(ms)
    return measured


def write(path: Path, given: Input) -> Path:
    """Write an input of a worker; return its file."""
    parts = {"truths": given.truths, "near": given.near}
    columns: dict[str, Any] = {name: part for name, part in parts.items() if part is not None}
    for k, recording in enumerate(given.recordings):
        scans = [recording.scan(i) for i in range(len(recording))]
        columns |= {
            f"{k}/points": np.concatenate([scan.points for scan in scans]),
            f"{k}/offsets": np.cumsum([0, *map(len, scans)]),
            f"{k}/stamps": recording.indices if recording.stamps is None else recording.stamps,
        }
        if recording.poses is not None:
            columns[f"{k}/poses"] = recording.poses
    np.savez(path, allow_pickle=False, **columns)
    return path


def measure(
    versions: Mapping[str, Command], work: Work, threads: int, repeats: int
) -> Iterator[Sequence[Cell]]:
    """Time work; return rows of the table, the first with the bound of a scan's stages."""
    title = work.title if threads == 1 else f"{work.title}, {threads} threads"
    if work.kind == "stages":
        points = float(np.median([len(each.recordings[0].scan(0)) for each in work.inputs]))
        ms = 12.0 * points / copy_gb_s() / 1e6
        yield (title, f"bound: one pass over {points:.0f} points", f"{ms:.3f}", *[None] * 5)
    yield from rows_of(title, in_turns(versions, work, threads, repeats))


def rows_of(title: str, measured: Mapping[str, Measured]) -> Iterator[Sequence[Cell]]:
    """Return the rows of some work.

    They have the versions, the counts of answers, the median and 95th percentile of each stage with
    their ratios, and how many times as long a refusal takes as an answer.
    """
    versions = measured[OURS], measured.get(OTHER, Measured())
    yield (title, "version", versions[0].version, None, versions[1].version, *[None] * 3)
    for kind in sorted({kind for each in versions for kind in each.counts}):
        counts = [each.counts[kind] if each.ms else None for each in versions]
        yield (title, f"answers: {kind}", counts[0], None, counts[1], *[None] * 3)
    for stage in dict.fromkeys(stage for each in versions for stage in each.ms):
        ours, other = (np.percentile(each.ms.get(stage, [np.nan]), (50, 95)) for each in versions)
        yield (title, stage, *map(_cell, (*ours, *other, *(ours / other))))
    if all(kind in versions[0].ms for kind in ("found", "refused")):
        ratios = (_cell(each.median("refused") / each.median("found")) for each in versions)
        yield (title, "refused over found", next(ratios), None, next(ratios), *[None] * 3)


def _cell(value: float) -> Cell:
    return f"{value:.2f}" if np.isfinite(value) else None


def tables(rows: Sequence[Sequence[Cell]]) -> list[Table]:
    """Tabulate whole work; none without rows."""
    note = (
        "Milliseconds, median and 95th percentile: of the processor for one thread, of the wall "
        "for several. Stages of queries are timed by the wall in versions whose localizer takes no "
        f"clock. Memory is copied at {copy_gb_s():.1f} GB/s."
    )
    return [Table(COLUMNS, rows, note, "Whole work")] if rows else []
