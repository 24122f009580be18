"""Read the queries of a results folder, with stages if `segloc localize --debug` stored them."""

from __future__ import annotations

import io
import json
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar
from zipfile import BadZipFile, ZipFile

import numpy as np
from numpy.typing import NDArray

from ...errors import SeglocError
from ...geometry import first_of_cells
from ...map.identity import MAP_ID
from ...types import Float32, Int64, Pose
from .trace import Tables, Trace, confidence_tables, steps, summarize

Parsed = TypeVar("Parsed")
Outcome = Literal["localized", "refused", "false"]
DEBUG = "debug"
"""Subfolder of stored stages, one file per query."""
_VOXEL_M = 0.3
_STEP_M = 0.01  # unit of stored positions
_MAX_BYTES = 64_000_000
_DAMAGE = (
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    OverflowError,
    OSError,
    EOFError,
    NotImplementedError,
    RuntimeError,
    BadZipFile,
    zlib.error,
)


@dataclass(frozen=True)
class Shown:
    """One query of a results folder.

    Attributes
    ----------
    index : int
    outcome : "localized", "refused" or "false"
        "false" only if the truth is known.
    text : str
        Pose or reason, in one line.
    T_map_sensor : (4, 4) float64 or None
        None if it was not localized.
    stages : Stages or None
        Stage by stage, if stored.
    """

    index: int
    outcome: Outcome
    text: str
    T_map_sensor: Pose | None
    stages: Stages | None = None

    @property
    def T_map_best(self) -> Pose | None:
        """Pose of the sensor, also a rejected one if it is stored."""
        stages = self.stages
        if self.T_map_sensor is not None or stages is None or stages.T_map_local is None:
            return self.T_map_sensor
        return stages.T_map_local @ stages.T_local_sensor


def read_results(folder: Path) -> list[Shown]:
    """Read all queries of a results folder.

    Raises
    ------
    SeglocError
        If it is another kind of folder, or a file in it is damaged.
    """
    file = folder / "localizations.jsonl"
    try:
        lines = file.read_text("utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise SeglocError(f"{folder}: no results of `segloc localize --out` ({error})") from error
    return [
        replace(query, stages=unpack(stored.read_bytes(), str(stored)))
        if (stored := folder / DEBUG / f"{query.index}.npz").is_file()
        else query
        for query in parse_records(_as_shown, lines, file)
    ]


def stored_map_id(folder: Path) -> str | None:
    """Return the identity of the map of results; None if it is not stored."""
    try:
        return str(json.loads((folder / "summary.json").read_text("utf-8"))[MAP_ID])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def parse_records(parse: Callable[[Any], Parsed], lines: Sequence[str], file: Path) -> list[Parsed]:
    """Parse the records of a file, one per line.

    Raises
    ------
    SeglocError
        If a record is damaged; names its line.
    """
    found = []
    for number, line in enumerate(lines, 1):
        try:
            found.append(parse(json.loads(line)))
        except (ValueError, KeyError, TypeError) as error:
            raise SeglocError(f"{file}: line {number}: damaged ({error})") from error
    return found


def pose_of(rows: Any) -> Pose | None:
    """Return a pose of 4 rows, or None."""
    return None if rows is None else np.array(rows, dtype=np.float64).reshape(4, 4)


def _as_shown(record: Any) -> Shown:
    index, confidence = int(record["index"]), float(record["confidence"])
    T, message = pose_of(record["T_map_sensor"]), str(record["message"])
    correct = record.get("correct")
    outcome: Outcome = "refused" if T is None else "false" if correct is False else "localized"
    return Shown(index, outcome, f"{message or 'localized'} (confidence {confidence:.2f})", T)


@dataclass(frozen=True)
class Stages:
    """Stages of one query, reduced to what a viewer draws.

    Attributes
    ----------
    name : str
    summary : str
        One sentence.
    steps : tuple of str
        One line per stage.
    tables : tuple
        Evidence, by :func:`~segloc.tools.inspect.confidence_tables`.
    localized : bool
    T_local_sensor : (4, 4) float64
    T_map_local : (4, 4) float64 or None
        The best pose, accepted or not.
    T_map_other : (4, 4) float64 or None
        Pose of the sensor at the runner-up.
    points : (N, 3) float32
        Above-ground points, thinned, local frame.
    on_map : (N,) bool
        True for points on the map at the best pose.
    segment_points : (M, 3) float32
    segment_of : (M,) int64
        Segment of each point.
    centroids : (K, 3) float32
        Of matched segments, local frame.
    matched : (K,) int64
        Matched segments of the map, by row.
    inliers : (K,) bool
    """

    name: str
    summary: str
    steps: tuple[str, ...]
    tables: Tables
    localized: bool
    T_local_sensor: Pose
    T_map_local: Pose | None
    T_map_other: Pose | None
    points: Float32
    on_map: NDArray[np.bool_]
    segment_points: Float32
    segment_of: Int64
    centroids: Float32
    matched: Int64
    inliers: NDArray[np.bool_]


def stages_of(trace: Trace) -> Stages:
    """Reduce a trace to what a viewer draws."""
    other = trace.result.places[1] if len(trace.result.places) > 1 else None
    keep = first_of_cells(trace.structure, _VOXEL_M)
    segments = trace.segments
    owner = np.repeat(np.arange(len(segments)), segments.sizes)
    few = first_of_cells(segments.points, _VOXEL_M)
    return Stages(
        name=trace.name,
        summary=summarize(trace),
        steps=tuple(f"{name}: {text}" for name, text in steps(trace)),
        tables=confidence_tables(trace),
        localized=trace.result.localized,
        T_local_sensor=trace.T_local_sensor,
        T_map_local=trace.T_map_local,
        T_map_other=None if other is None else other.T_map_sensor,
        points=trace.structure[keep],
        on_map=trace.on_map[keep],
        segment_points=segments.points[few],
        segment_of=owner[few],
        centroids=segments.centroids[trace.pairs[:, 0]].astype(np.float32),
        matched=trace.pairs[:, 1],
        inliers=trace.inliers,
    )


_POINTS = ("points", "segment_points", "centroids")


def pack(query: Stages) -> bytes:
    """Serialize the stages of a query compactly; reproducible."""
    entries = {
        "name": query.name,
        "verdict": query.summary,
        "steps": query.steps,
        "tables": query.tables,
        "localized": query.localized,
        "T_local_sensor": query.T_local_sensor.tolist(),
        "T_map_local": None if query.T_map_local is None else query.T_map_local.tolist(),
        "T_map_other": None if query.T_map_other is None else query.T_map_other.tolist(),
    }
    arrays = {
        name: np.round(getattr(query, name) / _STEP_M).clip(-32767, 32767).astype(np.int16)
        for name in _POINTS
    }
    arrays |= {"on_map": np.packbits(query.on_map), "inliers": np.packbits(query.inliers)}
    arrays |= {name: getattr(query, name).astype(np.int32) for name in ("segment_of", "matched")}
    text = np.frombuffer(json.dumps(entries).encode(), np.uint8)
    file = io.BytesIO()
    np.savez_compressed(file, text=text, **arrays)
    return file.getvalue()


def unpack(data: bytes, where: str) -> Stages:
    """Read the output of :func:`pack`.

    Raises
    ------
    SeglocError
        If it is damaged; names ``where``.
    """
    try:
        with ZipFile(io.BytesIO(data)) as listed:
            if sum(each.file_size for each in listed.infolist()) > _MAX_BYTES:
                raise ValueError("too large")
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        entries = json.loads(arrays["text"].tobytes())
        points = {name: arrays[name].reshape(-1, 3) * np.float32(_STEP_M) for name in _POINTS}
        query = Stages(
            name=str(entries["name"]),
            summary=str(entries["verdict"]),
            steps=tuple(map(str, entries["steps"])),
            tables=tuple(
                (str(title), tuple((str(x), str(label), str(words)) for x, label, words in rows))
                for title, rows in entries["tables"]
            ),
            localized=bool(entries["localized"]),
            T_local_sensor=np.array(entries["T_local_sensor"], np.float64).reshape(4, 4),
            T_map_local=pose_of(entries["T_map_local"]),
            T_map_other=pose_of(entries["T_map_other"]),
            on_map=_bits(arrays["on_map"], len(points["points"])),
            inliers=_bits(arrays["inliers"], len(points["centroids"])),
            segment_of=arrays["segment_of"].astype(np.int64),
            matched=arrays["matched"].astype(np.int64),
            **points,
        )
    except _DAMAGE as error:
        raise SeglocError(f"{where}: damaged ({' '.join(str(error).split())[:80]})") from error
    lengths = (len(query.segment_of), len(query.matched))
    if lengths != (len(query.segment_points), len(query.centroids)):
        raise SeglocError(f"{where}: damaged (arrays of different lengths)")
    return query


def _bits(packed_bits: NDArray[np.uint8], count: int) -> NDArray[np.bool_]:
    return np.unpackbits(packed_bits, count=count).astype(bool)
