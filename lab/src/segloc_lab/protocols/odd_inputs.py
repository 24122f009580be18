"""Odd inputs through the command line: each must give an answer or one line, within seconds.

    python -m segloc_lab.protocols.odd_inputs FOLDER... [--fuzz BYTES] [--report FOLDER]

Every file and folder below the FOLDERs is given to ``segloc doctor``. With ``--fuzz`` copies of the
small ones are damaged at random places (values changed, ends cut off) until that many bytes were
changed, and given to ``segloc info``. Text and pose files are given to ``info`` with the scans of
the sample.
"""

from __future__ import annotations

import json
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from segloc.io import write_scan
from segloc.sample import load

from ..report import Cell, Table, publish, reporting

LIMIT_S = 10.0
"""Maximum time of one command, without the start of the process [s]."""

_POSES = (".tum", ".txt", ".csv")
_MAX_BYTES = 1 << 20  # of an input that is damaged
_CHANGED_AT_ONCE = 4000  # bytes of one copy, at most; most copies have far fewer
_CHILD = """
import contextlib, io, json, sys
from segloc.cli import main
for line in sys.stdin:
    sys.argv = ["segloc", *json.loads(line)]
    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
        except BaseException as error:
            code = f"{type(error).__name__}: {error}"
    print(json.dumps([code, out.getvalue(), err.getvalue()]), flush=True)
"""


@dataclass(frozen=True)
class Outcome:
    """How a command ended: "read", "refused", "hangs", "crashes" or "traceback"."""

    kind: str
    line: str
    seconds: float


class CommandLine:
    """Run verbs in a child process, which is replaced if it hangs or dies."""

    def __init__(self) -> None:
        self._child: subprocess.Popen[str] | None = None

    def run(self, *words: str) -> Outcome:
        """Run one verb."""
        if self._child is None:
            command = [sys.executable, "-c", _CHILD]
            pipe = subprocess.PIPE
            self._child = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
        child, begun = self._child, time.monotonic()
        assert child.stdin is not None and child.stdout is not None
        child.stdin.write(json.dumps(words) + "\n")
        child.stdin.flush()
        line = _line_within(child, LIMIT_S)
        seconds = time.monotonic() - begun
        if not line:
            kind = "hangs" if child.poll() is None else "crashes"
            self.close()
            return Outcome(kind, "", seconds)
        code, out, err = json.loads(line)
        lines = [text for text in (*err.splitlines(), *out.splitlines()) if text.strip()]
        errors = [text for text in lines if "error:" in text]
        if isinstance(code, str):
            return Outcome("traceback", code, seconds)
        refused = code != 0 and bool(errors)
        found = [s for s in lines if "problem:" in s or "wrong:" in s or "note:" in s]
        shown = errors if refused else found or lines
        return Outcome("refused" if refused else "read", shown[0] if shown else "", seconds)

    def close(self) -> None:
        """End the child."""
        if self._child is not None:
            self._child.kill()
            self._child.wait()
            self._child = None


def _line_within(child: subprocess.Popen[str], limit_s: float) -> str:
    assert child.stdout is not None
    ready, _, _ = select.select([child.stdout], [], [], limit_s)
    return child.stdout.readline() if ready else ""


def inputs(folders: list[Path]) -> Iterator[Path]:
    """Return the files and the folders of scans or bags below some folders."""
    for folder in folders:
        for case in sorted(folder.iterdir()):
            yield from sorted(case.iterdir()) if case.is_dir() else [case]


def words_for(path: Path, scans: Path) -> tuple[str, ...]:
    """Return the command for an input, with the sample's pose file for its scans."""
    if path.is_file() and path.suffix in _POSES:
        return "doctor", str(scans), "--poses", str(path)
    return "doctor", str(path)


def damaged(path: Path, folder: Path, rng: np.random.Generator) -> tuple[Path, int]:
    """Copy an input with bytes of one file changed or removed; return how many."""
    copy = folder / path.name
    shutil.rmtree(copy, ignore_errors=True)
    if path.is_dir():
        shutil.copytree(path, copy)
    else:
        shutil.copy(path, copy)
    files = [copy] if copy.is_file() else sorted(p for p in copy.rglob("*") if p.is_file())
    victim = files[rng.integers(len(files))]
    data = np.frombuffer(victim.read_bytes(), np.uint8).copy()
    if not len(data):
        return copy, 0
    count = int(min(_CHANGED_AT_ONCE, len(data)) ** rng.random())
    if rng.random() < 0.2:
        victim.write_bytes(data[: len(data) - count].tobytes())
        return copy, count
    near_start = rng.random() < 0.5
    where = rng.integers(min(len(data), 512) if near_start else len(data), size=count)
    data[where] = rng.integers(0, 256, count, dtype=np.uint8)
    victim.write_bytes(data.tobytes())
    return copy, count


def fuzz(paths: list[Path], most_bytes: int, seed: int = 0) -> list[list[Cell]]:
    """Run damaged copies; return rows of outcomes by input."""
    rng, line = np.random.default_rng(seed), CommandLine()
    small = [path for path in paths if _size(path) <= _MAX_BYTES]
    ends: dict[str, Counter[str]] = {path.name: Counter() for path in small}
    changed, slowest = Counter[str](), Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        while changed.total() < most_bytes:
            for path in small:
                copy, count = damaged(path, Path(folder), rng)
                outcome = line.run("info", str(copy))
                ends[path.name][outcome.kind] += 1
                changed[path.name] += count
                slowest[path.name] = max(slowest[path.name], round(1e3 * outcome.seconds))
                if outcome.kind not in ("read", "refused"):
                    print(f"{path}: {outcome}", file=sys.stderr, flush=True)
    line.close()
    kinds = ("read", "refused", "hangs", "crashes", "traceback")
    return [
        [name, changed[name], *(counts[kind] for kind in kinds), slowest[name]]
        for name, counts in ends.items()
    ]


def _size(path: Path) -> int:
    files = [path] if path.is_file() else path.rglob("*")
    return sum(file.stat().st_size for file in files if file.is_file())


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("folders", type=Path, nargs="+", metavar="FOLDER")
    options.add_argument("--fuzz", type=int, default=0, metavar="BYTES")
    args = options.parse_args()
    paths, line = list(inputs(args.folders)), CommandLine()
    rows: list[list[Cell]] = []
    with tempfile.TemporaryDirectory() as folder:
        scans = Path(folder) / "scans"
        scans.mkdir()
        drive = load("tuesday")
        for k in range(0, len(drive), 2):
            write_scan(scans / f"{k:04d}.npy", drive.scan(k).points)
        for path in paths:
            outcome = line.run(*words_for(path, scans))
            text = outcome.line.replace(str(path.parent), path.parent.name)[:160].replace("|", "/")
            shown = f"{path.parent.name}/{path.name}"
            rows.append([shown, outcome.kind, round(outcome.seconds, 1), text])
    line.close()
    tables = [Table(("input", "ends", "s", "line"), rows, title="`segloc doctor` on each input")]
    if args.fuzz:
        columns = ("input", "bytes changed", "read", "refused", "hangs", "crashes", "traceback")
        found = fuzz(paths, args.fuzz)
        total: list[Cell] = ["all", *(sum(int(row[k] or 0) for row in found) for k in range(1, 7))]
        total.append(max(int(row[7] or 0) for row in found))
        note = f"Limit of one command: {LIMIT_S:g} s."
        tables.append(Table((*columns, "slowest ms"), [*found, total], note, "Damaged copies"))
    publish(args.report, "Odd inputs", *tables)


if __name__ == "__main__":
    main()
