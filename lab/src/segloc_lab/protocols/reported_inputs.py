"""Reported inputs through the command line: each gives an answer or one line, within seconds.

    python -m segloc_lab.protocols.reported_inputs --data DATA [--fuzz BYTES] [--report FOLDER]

Each file and recording in ``odd_inputs`` and ``formats_found`` of DATA is given to ``segloc
doctor``; text and pose files with the scans of the sample. ``reported_*`` have folders with a
``run.sh`` that makes inputs and runs commands; it finds segloc in SEGLOC, DATA in DATA, a clone in
MAIN and a folder for its files in WORK. In its output ``$ COMMAND`` or ``### NAME`` begins a case,
``status N`` ends a command; output without such lines has a case per line.

With ``--fuzz`` copies of the small inputs, those of ``run.sh`` among them, are damaged at random
places (values changed, ends cut off) until that many bytes were changed, and given to ``segloc
info``.
"""

from __future__ import annotations

import json
import os
import re
import select
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from segloc.sample import load
from segloc.tools.io import write_scan

from ..report import Cell, Table, publish, reporting

LIMIT_S = 10.0
"""Maximum processor time of one command [s]."""

HUNG_S = 120.0
"""Wait for one command, however busy the machine [s]."""

CASE_LIMIT_S = 1800.0
"""Maximum time of one ``run.sh`` [s]."""

OFF_M = 2.0
"""Answers farther off are false [m]."""

SOUND = re.compile(
    r"right|plain|nan|inf|one_scan|mgrs_f4|full|body_only|none|right_f8_ns|float(16|32|64)|list|fortran|"
    r"big|read-only|strided|longdouble|structured|record|organised|torch|masked|homogeneous|"
    r"memoryview|(crlf_bom|utm|decimal_comma)\.tum|(rtabmap(0|11)|kiss_slam|kitti16)\.txt|"
    r"(index_kitti13|seven_no_time)\.txt|g2o\.g2o|euler_header\.csv|beside_(empty|broken|json)|whole"
)
"""Words in the names of cases without a fault, or whose fault is repaired without a loss."""

_CLONE = Path(__file__).resolve().parents[4]
_BEGINS = re.compile(r"(?:\$|###) (.+)")
_STATUS = re.compile(r"(?:-> )?status (\d+)$")
_TRACEBACK = re.compile(r"Traceback|TRACEBACK|^ *File \".*\", line \d+", re.MULTILINE)
_FOUND = re.compile(
    r"problem|wrong|note:|error|refused|Invalid|left out|drop|skip|Error|lost|warn", re.I
)
_TELLING = re.compile(r"[A-Za-z]{3}")
_NOTHING = re.compile(r"no problems found|problems\W+none")
_OFF = re.compile(r"([\d.]+) m off|(?<=m off: )[-\d. ]+|(?<=metres off: )[-\d. ]+")

_POSES = (".tum", ".txt", ".csv")
_MAX_BYTES = 1 << 20  # of an input that is damaged
_CHANGED_AT_ONCE = 4000  # bytes of one copy, at most; most copies have far fewer
_CHILD = """
import contextlib, io, json, sys
from segloc.tools.cli import main
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
    seconds: float  # of the processor


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
        child, begun_s = self._child, _cpu_s(self._child.pid)
        assert child.stdin is not None and child.stdout is not None
        child.stdin.write(json.dumps(words) + "\n")
        child.stdin.flush()
        line = _line_within(child, HUNG_S)
        seconds = _cpu_s(child.pid) - begun_s
        if not line or seconds > LIMIT_S:
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


@dataclass
class Case:
    """Commands of a case: their output, statuses and time."""

    name: str
    lines: list[str] = field(default_factory=list)
    statuses: list[int] = field(default_factory=list)
    cpu_s: float = 0.0  # of its processes [s]

    @property
    def is_sound(self) -> bool:
        """Whether the input has no fault."""
        words = re.split(r"[\s/]+", self.name.removesuffix(".mcap"))
        return any(map(SOUND.fullmatch, words))

    def flags(self) -> list[str]:
        """What somebody has to look at."""
        text, found = _NOTHING.sub("", "\n".join(self.lines)), list[str]()
        if _TRACEBACK.search(text):
            found.append("traceback")
        if 137 in self.statuses:
            found.append("killed")
        elif self.cpu_s > LIMIT_S:
            found.append("slow")
        if any(m > OFF_M for m in _metres_off(text)):
            found.append("false")
        if self.is_sound and any(self.statuses):
            found.append("refused")
        if not self.is_sound and not any(self.statuses) and not _FOUND.search(text):
            found.append("silent")
        return found


def _metres_off(text: str) -> list[float]:
    found = (match[1] or match[0] for match in _OFF.finditer(text))
    return [float(word) for each in found for word in each.split() if word.strip("-.")]


def run_case(folder: Path, data: Path, work: Path) -> list[Case]:
    """Run the ``run.sh`` of a reported input."""
    binary = Path(sys.executable).parent
    paths = {"SEGLOC": binary / "segloc", "DATA": data, "WORK": work, "MAIN": _CLONE}
    command = ["timeout", "-s", "KILL", str(CASE_LIMIT_S), "bash", "run.sh"]
    environment = {**os.environ, **{k: str(v.resolve()) for k, v in paths.items()}, **_ENVIRONMENT}
    cases, spent_s = [Case(folder.name)], 0.0
    with subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    ) as child:
        assert child.stdout is not None
        for line in child.stdout:
            now_s = _cpu_s(child.pid) or spent_s
            cases[-1].cpu_s += now_s - spent_s
            spent_s = now_s
            if begins := _BEGINS.match(line):
                cases.append(Case(begins[1].strip()))
            elif status := _STATUS.match(line.strip()):
                cases[-1].statuses.append(int(status[1]))
            elif line.strip():
                cases[-1].lines.append(line.rstrip())
    if len(cases) == 1:
        ended = [Case("end", [], [child.returncode])] if child.returncode else []
        return [*(Case(re.split(r"\s{2,}", s)[0], [s]) for s in cases[0].lines), *ended]
    return [case for case in cases[1:] if case.lines or case.statuses]


_ENVIRONMENT = {"PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": "1", "COLUMNS": "200"}


def _cpu_s(pid: int) -> float:
    """Return the processor time of a process and all its descendants, ended ones too [s]."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].split()
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:  # it has ended, and its parent counts it
        return 0.0
    own = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    return own + sum(_cpu_s(int(child)) for child in children)


def inputs(folders: list[Path]) -> Iterator[Path]:
    """Return the files and the folders of scans or bags below some folders."""
    for folder in filter(Path.is_dir, folders):
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


def shortened(text: str, *folders: Path) -> str:
    """Return a line for a cell of a table, without the places of folders."""
    for folder in folders:
        text = text.replace(f"{folder}/", "")
    return text.strip()[:160].replace("|", "/")


def run_doctor(paths: list[Path], work: Path) -> Table:
    """Give each input to ``segloc doctor``."""
    line, scans = CommandLine(), work / "scans"
    scans.mkdir()
    drive = load("tuesday")
    for k in range(0, len(drive), 2):
        write_scan(scans / f"{k:04d}.npy", drive.scan(k).points)
    rows: list[list[Cell]] = []
    for path in paths:
        outcome = line.run(*words_for(path, scans))
        text = outcome.line.replace(str(path.parent), path.parent.name)[:160].replace("|", "/")
        shown = f"{path.parent.name}/{path.name}"
        rows.append([shown, outcome.kind, round(outcome.seconds, 1), text])
    line.close()
    return Table(("input", "ends", "s", "line"), rows, title="`segloc doctor` on each input")


def run_collection(collection: Path, data: Path, work: Path) -> Table:
    """Run each case of a collection."""
    rows: list[list[Cell]] = []
    flagged: Counter[str] = Counter()
    for folder in sorted(path.parent for path in collection.glob("*/run.sh")):
        for case in run_case(folder, data, work):
            flags = case.flags()
            flagged.update(flags)
            statuses = " ".join(map(str, case.statuses))
            lines = [line for line in case.lines[::-1] if _TELLING.search(line)]
            last = next(filter(_FOUND.search, lines), lines[0] if lines else "")
            cells = shortened(case.name, work), statuses, round(case.cpu_s, 1), " ".join(flags)
            rows.append([folder.name, *cells, shortened(last, work)])
            print(*rows[-1], sep=" | ", file=sys.stderr, flush=True)
    counts = ", ".join(f"{name} {flagged[name]}" for name in FLAGS)
    note = (
        f"{len(rows)} cases; {counts}. *slow*: more than {LIMIT_S:g} s of processor time; *false*: "
        f"more than {OFF_M:g} m off; *silent*: an input with a fault is read without a word; "
        "*refused*: one without a fault is not."
    )
    columns = ("input", "case", "status", "s", "flags", "last line")
    return Table(columns, rows, note, f"`{collection.name}`")


FLAGS = ("traceback", "killed", "slow", "false", "silent", "refused")


def fuzzed(paths: list[Path], most_bytes: int) -> Table:
    """Damage copies of inputs, and give them to ``segloc info``."""
    columns = ("input", "bytes changed", "read", "refused", "hangs", "crashes", "traceback")
    found = fuzz(paths, most_bytes)
    total: list[Cell] = ["all", *(sum(int(row[k] or 0) for row in found) for k in range(1, 7))]
    total.append(max(int(row[7] or 0) for row in found))
    note = f"Limit of one command: {LIMIT_S:g} s of processor time."
    return Table((*columns, "slowest ms"), [*found, total], note, "Damaged copies")


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("--data", type=Path, required=True, metavar="DATA")
    options.add_argument("--fuzz", type=int, default=0, metavar="BYTES")
    args = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder) / "work"
        work.mkdir()
        paths = list(inputs([args.data / "odd_inputs", args.data / "formats_found"]))
        tables = [run_doctor(paths, Path(folder))]
        for collection in sorted(args.data.glob("reported_*")):
            tables.append(run_collection(collection, args.data, work))
        if args.fuzz:
            made = inputs([path for path in sorted(work.iterdir()) if path.name[:1].isdigit()])
            tables.append(fuzzed([*paths, *made], args.fuzz))
    publish(args.report, "Reported inputs", *tables)


if __name__ == "__main__":
    main()
