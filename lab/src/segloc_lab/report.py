"""Dated reports of studies: a folder with REPORT.md, rows.json and environment.txt."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import shlex
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from segloc.errors import ConfigError
from segloc.system.files import write_bytes, write_text
from segloc.tools.cli.machine import processor

from .script import parser


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Wilson's score interval of a share at 95 %; (0, 1) of no trials."""
    if not trials:
        return 0.0, 1.0
    interval = binomtest(successes, trials).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def share(successes: int, trials: int) -> str:
    """A count with its interval in percent, as "8 of 10 (49 to 94 %)"."""
    low, high = wilson(successes, trials)
    digits = 0 if trials < 200 else 1
    interval = f" ({100 * low:.{digits}f} to {100 * high:.{digits}f} %)" if trials else ""
    return f"{successes} of {trials}{interval}"


def apart(a: Sequence[bool], b: Sequence[bool]) -> tuple[int, int]:
    """How often the first alone succeeded, and the second alone, of the same queries."""
    pairs = list(zip(a, b, strict=True))
    return sum(x and not y for x, y in pairs), sum(y and not x for x, y in pairs)


def mcnemar(a: Sequence[bool], b: Sequence[bool]) -> float:
    """McNemar's exact test: the probability of such a difference between equally good methods.

    Parameters
    ----------
    a, b : sequences of bool
        Whether each method succeeded, query by query, in the same order.

    Returns
    -------
    float
        Two-sided p-value; 1 where no query tells them apart.
    """
    only_a, only_b = apart(a, b)
    if not only_a + only_b:
        return 1.0
    return float(binomtest(only_a, only_a + only_b, 0.5).pvalue)


def reporting(doc: str | None) -> argparse.ArgumentParser:
    """Make a parser with an option for the folder of the report."""
    options = parser(doc)
    options.add_argument(
        "--report", type=new_folder, metavar="FOLDER", help="new folder for a dated report"
    )
    return options


MADE_WITH = "made_with"
"""Key of what a kept entry was made with: code and options."""


def lines(*paths: Path) -> list[dict[str, Any]]:
    """Read the lines of JSON that runs have kept, in order."""
    return [json.loads(line) for path in paths for line in path.read_text("utf-8").splitlines()]


def entries(*paths: Path) -> list[dict[str, Any]]:
    """Read what runs have kept, without what it was made with.

    Raises
    ------
    ConfigError
        If it was made by different code or options.
    """
    found = lines(*paths)
    if any(each.get(MADE_WITH) != found[0].get(MADE_WITH) for each in found):
        names = ", ".join(str(path) for path in paths)
        raise ConfigError(f"{names}: made by different code or options")
    return without_maker(found)


def without_maker(found: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return entries without what they were made with."""
    return [{key: each[key] for key in each if key != MADE_WITH} for each in found]


def earlier(path: Path) -> list[dict[str, Any]]:
    """Read what an interrupted run has kept, less a line that it did not finish; nothing without.

    That line is removed from the file.
    """
    if not path.exists():
        return []
    data = path.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if whole != data:
        write_bytes(path, whole)
    return lines(path)


def keep(path: Path, entry: Mapping[str, Any]) -> None:
    """Append a line of JSON to a file, which need not exist."""
    with path.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(entry) + "\n")


def require_same(path: Path, made_with: Mapping[str, Any], stored: object) -> None:
    """Refuse to go on with a file of results that other code or options made.

    Raises
    ------
    ConfigError
    """
    if stored != made_with:
        raise ConfigError(f"{path}: made by other code or options: name a new file")


def row(*cells: object) -> str:
    """Format a row of a Markdown table."""
    return f"| {' | '.join(map(str, cells))} |"


Cell = str | int | float | None
_BEGAN = time.monotonic()
_CLONE = Path(__file__).resolve().parents[3]
_PACKAGES = ("segloc", "numpy", "scipy")
_CODE = ("src", "cpp", "lab/src")


@dataclass(frozen=True)
class Table:
    """Rows of one table, a note on how to read them, and a heading where there are several.

    Without columns it is a piece of text.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""
    title: str = ""
    level: int = 2

    def __post_init__(self) -> None:
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError(f"{self.title}: a row and the columns differ in length")

    @classmethod
    def of(cls, rows: Sequence[Mapping[str, Cell]], note: str = "", title: str = "") -> Table:
        """Make a table of cells by column; those that a row lacks stay empty."""
        columns = list(dict.fromkeys(name for row in rows for name in row))
        return cls(columns, [tuple(map(row.get, columns)) for row in rows], note, title)

    def parts(self) -> list[str]:
        """Format the heading, the table and the note as paragraphs of Markdown."""
        rows = (self.columns, ["---"] * len(self.columns), *self.rows) if self.columns else ()
        table = "\n".join(row(*map(_text, cells)) for cells in rows)
        heading = f"{'#' * self.level} {self.title}" if self.title else ""
        return [part for part in (heading, table, self.note) if part]


def publish(folder: Path | None, title: str, *tables: Table) -> None:
    """Print the tables, and write them as a report where a folder is given."""
    print("\n\n".join(part for table in tables for part in table.parts()))
    if folder is not None:
        print(write(folder, title, tables))


def write(
    folder: Path, title: str, tables: Sequence[Table], pictures: Mapping[str, bytes] | None = None
) -> Path:
    """Write a report into a new folder, with pictures by file name."""
    require_new(folder)
    folder.mkdir(parents=True)
    minutes = (time.monotonic() - _BEGAN) / 60
    parts = [
        f"# {title}",
        f"    {command()}",
        f"{date.today().isoformat()}, commit {commit()}, {minutes:.1f} minutes on {machine()}.",
    ]
    for table in tables:
        parts += table.parts()
    rows = [{"title": t.title, "columns": t.columns, "rows": t.rows} for t in tables if t.columns]
    write_text(folder / "REPORT.md", "\n\n".join(parts) + "\n")
    write_text(folder / "rows.json", json.dumps(rows, ensure_ascii=False, indent=1) + "\n")
    write_text(folder / "environment.txt", environment())
    for name, picture in (pictures or {}).items():
        (folder / name).write_bytes(picture)
    return folder / "REPORT.md"


def require_new(folder: Path | None) -> None:
    """Refuse a folder that exists, before a study spends hours on its report."""
    if folder is not None and folder.exists():
        raise ConfigError(f"{folder}: exists, and reports are never rewritten; name a new folder")


def new_folder(text: str) -> Path:
    """Parse the folder of a report, which must not exist yet."""
    try:
        require_new(Path(text))
    except ConfigError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return Path(text)


def command() -> str:
    """Return the command line of this process; absolute paths are shortened to their names."""
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    name = spec.name.removesuffix(".__main__") if spec else ""
    program = f"python -m {name}" if name else Path(sys.argv[0]).name
    arguments = (Path(a).name if a.startswith("/") else a for a in sys.argv[1:])
    return f"{program} {shlex.join(arguments)}".rstrip()


def machine() -> str:
    """Return the processor and its number of cores."""
    return f"{processor()}, {os.cpu_count()} cores"


def environment() -> str:
    """Return the versions, the processor and the commit, one a line."""
    lines = [f"python {platform.python_version()} on {platform.platform()}"]
    lines += [f"{name} {version_of(name) or 'not installed'}" for name in _PACKAGES]
    return "\n".join([*lines, f"processor {machine()}", f"commit {commit()}"]) + "\n"


def commit() -> str:
    """Return the commit of the clone, with ``+`` if code differs; "unknown" outside of one."""
    try:
        found = git("rev-parse", "--short=10", "HEAD")
        return f"{found}+" if git("status", "--porcelain", "--", *_CODE) else found
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def code() -> str:
    """Return what tells whether kept answers are of this code, the laboratory's included.

    The git trees, and a digest of what differs from them.
    """
    try:
        trees = [
            tree[:10] for tree in git("rev-parse", *(f"HEAD:{part}" for part in _CODE)).split()
        ]
        changed = git("diff", "HEAD", "--", *_CODE)
        for name in git("ls-files", "--others", "--exclude-standard", "--", *_CODE).splitlines():
            changed += name + (_CLONE / name).read_text("utf-8", "replace")
    except (OSError, subprocess.CalledProcessError):
        return version("segloc")
    edits = [hashlib.sha256(changed.encode()).hexdigest()[:10]] if changed else []
    return "-".join([*trees, *edits])


def git(*arguments: str) -> str:
    """Run git in the clone and return what it prints."""
    done = ["git", "-C", str(_CLONE), *arguments]
    return subprocess.run(done, check=True, capture_output=True, text=True).stdout.strip()


def version_of(package: str) -> str | None:
    """Return the version of a package; None if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _text(cell: Cell) -> str:
    return "-" if cell is None else f"{cell:g}" if isinstance(cell, float) else str(cell)
