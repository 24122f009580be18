"""A result on disk: what was measured, by which command, and the fingerprints of what made it."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from segloc.errors import DatasetError

from ..script import show
from .fingerprints import PROJECT, changed, fingerprints

FOLDER = PROJECT / "docs" / "results"
"""Where results are kept, beside the pages that show them."""

Cell = str | int | float | None


@dataclass(frozen=True)
class Origin:
    """Of which code and weights something is.

    Attributes
    ----------
    commit : str
        Of the clone; ends with ``+`` if files were changed there, "unknown" outside of one.
    produced_by : dict of str to str
        Fingerprints of stages and weights, see :mod:`.fingerprints`.
    """

    commit: str
    produced_by: Mapping[str, str]

    @classmethod
    def now(cls, methods: Iterable[str] = (), stages: Sequence[str] | None = None) -> Origin:
        """Of the code as it is; by default of every stage of a query."""
        if stages is None:
            return cls(commit(), fingerprints(methods=methods))
        return cls(commit(), fingerprints(stages, methods))

    @classmethod
    def of_all(cls, parts: Mapping[str, Origin]) -> Origin:
        """What several parts, by their names, have in common: one code, perhaps other methods.

        Where that is the code of this clone, so is the commit if no part knows its own.

        Raises
        ------
        DatasetError
            If they are not all of the same code.
        """
        produced: dict[str, str] = {}
        for name, part in parts.items():
            for stage, value in part.produced_by.items():
                if produced.setdefault(stage, value) != value:
                    raise DatasetError(
                        f"{name}: of another {stage} than those before it: measure all of them "
                        "with the same code"
                    )
        commits = sorted({part.commit for part in parts.values()})
        if commits == ["unknown"] and not changed(produced):
            commits = [commit()]
        return cls(", ".join(commits), produced)


@dataclass(frozen=True)
class Result:
    """One table, and what is needed to judge it and to make it again.

    Attributes
    ----------
    name : str
        Of its file, and of its place in a page.
    command : str
        That measured it.
    commit : str
        Of the clone that it was measured with; ends with ``+`` if files were changed there.
    produced_by : dict of str to str
        Fingerprints of stages and weights, see :mod:`.fingerprints`.
    columns : tuple of str
    rows : tuple of tuples of str, int, float or None
        As long as ``columns`` each.
    note : str
        How to read it.
    counts : dict
        What the rows were computed from, in values that JSON can hold.
    """

    name: str
    command: str
    commit: str
    produced_by: Mapping[str, str]
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""
    counts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError(f"{self.name}: a row of another length than the columns")

    @classmethod
    def measured(
        cls,
        name: str,
        command: str,
        columns: Sequence[str],
        rows: Sequence[Sequence[Cell]],
        *,
        stages: Sequence[str] | None = None,
        methods: Sequence[str] = (),
        note: str = "",
        counts: Mapping[str, Any] | None = None,
    ) -> Result:
        """A result of the code as it is now; by default of every stage of a query."""
        origin = Origin.now(methods, stages)
        return cls.of(origin, name, command, columns, rows, note=note, counts=counts)

    @classmethod
    def of(
        cls,
        origin: Origin,
        name: str,
        command: str,
        columns: Sequence[str],
        rows: Sequence[Sequence[Cell]],
        *,
        note: str = "",
        counts: Mapping[str, Any] | None = None,
    ) -> Result:
        """A result of other code, or of what was measured before."""
        table = (tuple(columns), tuple(map(tuple, rows)))
        return cls(name, command, origin.commit, origin.produced_by, *table, note, counts or {})

    def save(self, folder: Path = FOLDER) -> Path:
        """Write it as ``NAME.json``, a line a row."""
        value = asdict(self)
        rows = [json.dumps(row, ensure_ascii=False) for row in value.pop("rows")]
        text = json.dumps(value, indent=1, ensure_ascii=False)
        joined = ",\n  ".join(rows)
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{self.name}.json"
        path.write_text(f'{text[:-2]},\n "rows": [\n  {joined}\n ]\n}}\n', "utf-8")
        return path

    def tell(self, folder: Path | None) -> None:
        """Print the table and the note, and keep both where a folder is given."""
        show(self.columns, self.rows)
        if self.note:
            print(f"\n{self.note}")
        if folder is not None:
            print(self.save(folder))

    @classmethod
    def load(cls, path: Path) -> Result:
        """Read what :meth:`save` wrote."""
        value = json.loads(path.read_text("utf-8"))
        columns, rows = tuple(value.pop("columns")), tuple(map(tuple, value.pop("rows")))
        return cls(columns=columns, rows=rows, **value)


def commit() -> str:
    """The commit of this clone, shortened; "unknown" outside of one."""
    try:
        found = _git("rev-parse", "--short=10", "HEAD")
        changed = _git("status", "--porcelain", "--untracked-files=no", "--", "src", "cpp")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{found}+" if changed else found


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(PROJECT), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
