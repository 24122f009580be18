"""What a study of the evaluation ends in: tables, figures and facts, on disk as JSON and arrays."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from segloc.errors import SeglocError
from segloc.system.files import replacing
from segloc.types import Float64

Cell = str | float | int | None
Kind = Literal["roc", "polar", "bars", "map", "lines"]
Curve = tuple[Float64, Float64]

FORMAT = 1
_JSON, _ARRAYS = "study.json", "arrays.npz"


@dataclass(frozen=True)
class Table:
    """Rows of figures, ours or published ones.

    Attributes
    ----------
    name : str
        Of its files; letters, digits, ``-`` and ``_``.
    title : str
    columns : tuple of str
    rows : tuple of tuples of str, float, int or None
        As long as ``columns`` each; None is "nothing to say". The first cell names the row.
    note : str
        How to read it.
    source : str
        "segloc", or "paper" for published figures that stand beside ours.
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


@dataclass(frozen=True)
class Figure:
    """Data of a drawing; :mod:`~segloc_lab.evaluation.report.drawing` draws it.

    Attributes
    ----------
    name, title : str
    kind : str
        "roc" and "lines": x and y; "polar": degrees and radius; "bars": position and height of one
        bar each; "map": metres seen from above, where the label says what is drawn (see
        :data:`~segloc_lab.evaluation.report.drawing.MAP_STYLES`) and NaN breaks a line.
    series : dict of str to (x, y)
        (N,) float64 arrays.
    xlabel, ylabel : str
    note : str
        How to read it.
    top : float or None
        Largest radius of a polar drawing, so that several are drawn to one scale.
    fold : str
        What neighbours with the same one are folded away under; "" where it is in view.
    """

    name: str
    title: str
    kind: Kind
    series: Mapping[str, Curve]
    xlabel: str = ""
    ylabel: str = ""
    note: str = ""
    top: float | None = None
    fold: str = ""


@dataclass(frozen=True)
class Study:
    """One study of the evaluation.

    Attributes
    ----------
    name, title : str
    tables : tuple of Table
    figures : tuple of Figure
    facts : dict
        What JSON can hold: command, seed, scale, suite, fingerprints of the weights, versions,
        machine, seconds; see :meth:`~segloc_lab.studies.paper.workspace.Workspace.facts`.
    text : str
        What the study asks, for a reader who is new to it; paragraphs parted by empty lines.
    """

    name: str
    title: str
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    text: str = ""

    def to_json(self) -> str:
        """Everything but the arrays of the figures."""
        value = {
            "format": FORMAT,
            "name": self.name,
            "title": self.title,
            "text": self.text,
            "tables": [_plain(asdict(table)) for table in self.tables],
            "figures": [
                {**_described(figure), "series": list(figure.series)} for figure in self.figures
            ],
            "facts": _plain(dict(self.facts)),
        }
        return json.dumps(value, indent=1, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str, arrays: Mapping[str, NDArray[Any]]) -> Study:
        """The study that :meth:`to_json` wrote, with the arrays of :meth:`arrays`.

        Raises
        ------
        ValueError, KeyError, TypeError
            If it is no such text, or an array is missing.
        """
        value = json.loads(text)
        if value["format"] != FORMAT:
            raise ValueError(f"format {value['format']}, where {FORMAT} is known")
        tables = tuple(_table(table) for table in value["tables"])
        figures = tuple(_figure(figure, arrays) for figure in value["figures"])
        return cls(value["name"], value["title"], tables, figures, value["facts"], value["text"])

    def arrays(self) -> dict[str, Float64]:
        """The arrays of all figures, by names that :meth:`from_json` knows."""
        return {
            _key(figure.name, number, axis): np.asarray(values, dtype=np.float64)
            for figure in self.figures
            for number, curve in enumerate(figure.series.values())
            for axis, values in zip("xy", curve, strict=True)
        }

    def save(self, folder: Path) -> None:
        """Write ``study.json`` and ``arrays.npz`` to a folder, which is made where it is missing.

        Raises
        ------
        SeglocError
            If a file cannot be written.
        """
        _made(folder)
        with replacing(folder / _ARRAYS) as stream:
            np.savez_compressed(stream, **self.arrays())  # type: ignore[arg-type]
        with replacing(folder / _JSON) as stream:
            stream.write(self.to_json().encode())

    @classmethod
    def load(cls, folder: Path) -> Study:
        """Read what :meth:`save` wrote.

        Raises
        ------
        SeglocError
            If a file is missing or damaged; names it.
        """
        try:
            with (
                (folder / _ARRAYS).open("rb") as stream,
                np.load(stream, allow_pickle=False) as file,
            ):
                arrays = dict(file)
        except OSError as error:
            raise SeglocError(f"{folder / _ARRAYS}: cannot be read") from error
        except Exception as error:  # whatever a damaged archive makes of itself
            raise SeglocError(f"{folder / _ARRAYS}: damaged") from error
        path = folder / _JSON
        try:
            return cls.from_json(path.read_text("utf-8"), arrays)
        except OSError as error:
            raise SeglocError(f"{path}: cannot be read") from error
        except (ValueError, KeyError, TypeError) as error:
            raise SeglocError(f"{path}: damaged: {error}") from error


def stored(out: Path, order: Sequence[str] = ()) -> Iterator[Study]:
    """The studies that a folder of results holds: those that ``order`` names, then the others."""
    found = {path.parent.name: path.parent for path in out.glob(f"*/{_JSON}")}
    for name in (*(name for name in order if name in found), *sorted(found.keys() - set(order))):
        yield Study.load(found[name])


def _made(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SeglocError(f"{folder}: cannot be made: {error.strerror or error}") from error


def _key(figure: str, number: int, axis: str) -> str:
    return f"{figure}.{number}.{axis}"


def _described(figure: Figure) -> dict[str, Any]:
    names = ("name", "title", "kind", "xlabel", "ylabel", "note", "top", "fold")
    return {name: getattr(figure, name) for name in names}


def _figure(value: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Figure:
    described = dict(value)
    labels = described.pop("series")
    series = {
        label: (arrays[_key(value["name"], k, "x")], arrays[_key(value["name"], k, "y")])
        for k, label in enumerate(labels)
    }
    return Figure(series=series, **described)


def _table(value: Mapping[str, Any]) -> Table:
    rows = tuple(tuple(row) for row in value["rows"])
    return Table(**{**value, "columns": tuple(value["columns"]), "rows": rows})


def _plain(value: Any) -> Any:
    """The same in values that JSON can hold; what is not finite becomes None."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Mapping):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
