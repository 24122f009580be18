"""Tables, figures and facts of a study, written as a folder of Markdown and pictures."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from segloc.errors import MissingDependency, SeglocError
from segloc.system.files import replacing, write_text
from segloc.tools.inspect import DARK, GREEN, ORANGE, PALETTE, PATH, RED, blank, png
from segloc.types import Float64

from .. import report

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Cell = str | float | int | None
Kind = Literal["roc", "polar", "bars", "map", "lines"]
Curve = tuple[Float64, Float64]
LONG_ROWS = 40
"""Tables with more rows are stored as data only."""


@dataclass(frozen=True)
class Table:
    """Rows of measured or published figures.

    Attributes
    ----------
    rows : tuple of tuples of str, float, int or None
        The first cell is the row's name; None is "not measured".
    source : str
        "segloc", or "paper" for published figures.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""
    source: Literal["segloc", "paper"] = "segloc"

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f"table {self.name}: {len(row)} cells for {len(self.columns)} columns"
                )

    def text(self) -> str:
        """Format the table as Markdown with four significant digits."""
        rows = tuple(tuple(map(_short, row)) for row in self.rows)
        return "\n\n".join(replace(self, rows=rows).part(level=2).parts())

    def part(self, level: int) -> report.Table:
        """Return the table as a part of a report, with a heading of this level."""
        title = f"{self.title} (published)" if self.source == "paper" else self.title
        return report.Table(self.columns, self.rows, self.note, title, level)


@dataclass(frozen=True)
class Figure:
    """Data of a drawing.

    Attributes
    ----------
    kind : str
        "roc" and "lines": x and y; "polar": degrees and radius; "bars": position and height;
        "map": metres in the ground plane, drawn by label (:data:`MAP_STYLES`); NaN breaks a line.
    series : dict of str to (x, y)
        (N,) float64 arrays.
    top : float or None
        Maximum radius of a polar drawing.
    """

    name: str
    title: str
    kind: Kind
    series: Mapping[str, Curve]
    xlabel: str = ""
    ylabel: str = ""
    top: float | None = None

    def draw(self) -> bytes:
        """Draw the figure as PNG."""
        figure = blank((6.4, 6.4 if self.kind in ("map", "polar", "roc") else 3.9), 110)
        figure.set_layout_engine("constrained")
        axes = figure.add_subplot(projection="polar" if self.kind == "polar" else None)
        for k, (label, (x, y)) in enumerate(self.series.items()):
            colour = PALETTE[k % len(PALETTE)]
            if self.kind == "map":
                _on_map(axes, label, x, y, colour)
            elif self.kind == "bars":
                width = 0.8 / len(self.series)
                shift = (k - (len(self.series) - 1) / 2) * width
                axes.bar(x + shift, y, width=0.92 * width, color=colour, label=label)
            else:
                angle = np.radians(x) if self.kind == "polar" else x
                marker = "o" if len(x) <= 20 else ""
                axes.plot(angle, y, color=colour, lw=1.5, marker=marker, ms=3.5, label=label)
        if self.kind == "polar":
            axes.set_ylim(bottom=0, top=self.top)
        else:
            axes.set_xlabel(self.xlabel)
            axes.set_ylabel(self.ylabel)
        if self.kind == "map":
            axes.set_aspect("equal")
        else:
            axes.grid(alpha=0.35)
        if len(axes.get_legend_handles_labels()[0]) > 1:
            axes.legend(fontsize=8.5)
        return png(figure)


@dataclass(frozen=True)
class Study:
    """One study of the evaluation.

    Attributes
    ----------
    facts : dict
        Facts for repetition: command, seed, fingerprints of the weights, versions, machine.
    text : str
        Question of the study.
    """

    name: str
    title: str
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    text: str = ""

    def parts(self, *, alone: bool) -> list[report.Table]:
        """Return text, tables and links to pictures as parts of a report, with a title if among
        other studies.
        """
        links = "\n\n".join(f"![{figure.title}]({figure.name}.png)" for figure in self._curves())
        tables = [table.part(level=2 if alone else 3) for table in self.tables]
        head = report.Table((), (), self.text.strip(), "" if alone else self.title)
        return [head, *tables, report.Table((), (), links)]

    def pictures(self) -> dict[str, bytes]:
        """Draw the pictures of a report: maps, of which there are very many, are not."""
        return {f"{figure.name}.png": figure.draw() for figure in self._curves()}

    def _curves(self) -> list[Figure]:
        return [figure for figure in self.figures if figure.kind != "map"]

    def save(self, folder: Path) -> None:
        """Write ``REPORT.md``, ``study.json`` with every digit, and a picture per figure.

        Without matplotlib there are no figures, as noted in the report.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise SeglocError(f"{folder}: cannot be created: {error.strerror or error}") from error
        parts = [f"# {self.title}", self.text.strip()]
        parts += [table.text() for table in self.tables if len(table.rows) <= LONG_ROWS]
        try:
            for figure in self.figures:
                with replacing(folder / f"{figure.name}.png") as stream:
                    stream.write(figure.draw())
                parts.append(f"![{figure.title}]({figure.name}.png)")
        except MissingDependency as error:
            parts.append(f"No figures: {error}")
        facts = _plain(self.facts)
        parts.append("\n".join(f"- {name}: {value}" for name, value in facts.items()))
        write_text(folder / "REPORT.md", "\n\n".join(filter(None, parts)) + "\n")
        stored = {"tables": [_plain(asdict(table)) for table in self.tables], "facts": facts}
        write_text(folder / "study.json", json.dumps(stored, indent=1, allow_nan=False) + "\n")


MAP_STYLES: Mapping[str, dict[str, Any]] = {
    "map": {"marker": ",", "lw": 0, "color": PATH, "alpha": 0.5, "zorder": 0},
    "path of the map": {"color": PATH},
    "not localized": {"marker": "o", "lw": 0, "color": DARK, "fillstyle": "none", "zorder": 2},
    "true place of a false one": {"color": RED, "zorder": 3},
    "localized": {"marker": "o", "lw": 0, "color": GREEN, "zorder": 4},
    "localized falsely": {"marker": "o", "lw": 0, "color": RED, "zorder": 5},
    "query": {"marker": ",", "lw": 0, "color": ORANGE},
}
"""How a series of a map is drawn, by its label; any other is a line."""


def _on_map(axes: Axes, label: str, x: Float64, y: Float64, colour: str) -> None:
    style: dict[str, Any] = {"color": colour, "lw": 1.2, "ms": 4.5, **MAP_STYLES.get(label, {})}
    counted = f"{label} ({len(x)})" if style.get("marker") == "o" else label
    axes.plot(x, y, label=counted if len(x) else None, **style)


def _short(cell: Cell) -> Cell:
    if isinstance(cell, float):
        return f"{cell:.4g}" if math.isfinite(cell) else None
    return cell


def _plain(value: Any) -> Any:
    """The same in values that JSON can hold; a number that is not finite becomes None."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Mapping):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
