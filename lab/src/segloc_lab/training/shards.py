"""Datasets as folders: one shard per session, and an index with labels.

``index.json`` lists places and sessions; ``labels.safetensors`` holds the labels of each shard's
segments, which need all sessions of a place. Finished shards are kept, so an interrupted extraction
resumes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from segloc.errors import DatasetError
from segloc.system import tensor_file
from segloc.system.files import replacing, write_text
from segloc.system.tensor_file import TensorFileError
from segloc.types import Int64

from .dataset import FAR_M, SegmentDataset, read_arrays
from .extract import Extract, ExtractConfig
from .labels import LabelConfig, LabelCounts, count_labels, label_objects

INDEX = "index.json"
_LABELS = "labels.safetensors"
_VERSION = 1


@dataclass(frozen=True)
class Session:
    """One recording of a place, with the name of its shard and its sensor."""

    place: str
    name: str
    sensor: str

    @property
    def file(self) -> str:
        return f"{self.place}--{self.name}.safetensors"


def options_of(config: ExtractConfig, **more: Any) -> str:
    """Return a hash of everything that affects a shard."""
    text = config.model_dump_json(exclude={"label"}) + json.dumps(more, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def write_shard(
    folder: Path, session: Session, extract: Extract, options: str, scans: str = ""
) -> None:
    """Write a session's shard, with points in half precision about their centroids.

    ``scans`` is a hash of what it was made of, by which it is known under another name.
    """
    arrays = {f.name: getattr(extract, f.name) for f in fields(Extract)}
    arrays["points"] = arrays["points"].astype(np.float16)
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(folder / session.file) as stream:
        tensor_file.write_tensors(
            stream, arrays, {"options": options, "scans": scans, **asdict(session)}
        )


def finished(folder: Path, session: Session, options: str) -> bool:
    """Return whether a session's shard with these options exists."""
    return stored(folder, session, "options") == options


def stored(folder: Path, session: Session, key: str) -> str:
    """Return a text that a session's shard has of itself; "" without the shard, or the text."""
    try:
        with tensor_file.open_tensor_file(folder / session.file) as file:
            return file.metadata.get(key, "")
    except (OSError, TensorFileError):
        return ""


def read_array(folder: Path, session: Session, name: str) -> Any:
    """Read one array of a shard."""
    return read_arrays(folder / session.file, [name])[0][name]


def finish(folder: Path, sessions: Sequence[Session], config: LabelConfig) -> LabelCounts:
    """Label the segments of these and all other sessions in the folder, and write the index.

    Another session of the same scans and place, under the name of another order, is left out.

    Returns
    -------
    LabelCounts
        Of the whole dataset. Pairs are counted within places.
    """
    before = _listed(folder) if (folder / INDEX).exists() else []
    scans = {(session.place, stored(folder, session, "scans")) for session in sessions}
    again = scans - {(session.place, "") for session in sessions}
    others = [
        session
        for session in before
        if session in sessions or (session.place, stored(folder, session, "scans")) not in again
    ]
    known = {session.file: session for session in (*others, *sessions)}
    everything = sorted(known.values(), key=lambda session: session.file)
    labels: dict[str, Int64] = {}
    counts: list[LabelCounts] = []
    for place in sorted({session.place for session in everything}):
        own = [session for session in everything if session.place == place]
        found, count = _label_place(folder, own, config)
        labels.update(found)
        counts.append(count)
    total = _total(counts)
    with replacing(folder / _LABELS) as stream:
        tensor_file.write_tensors(stream, labels, {})
    index = {
        "version": _VERSION,
        "label": config.model_dump(),
        "sessions": [asdict(session) for session in everything],
        "counts": asdict(total),
    }
    write_text(folder / INDEX, json.dumps(index, indent=2).replace("NaN", "null") + "\n")
    return total


def _listed(folder: Path) -> list[Session]:
    """Return the sessions in a folder's index."""
    path = folder / INDEX
    try:
        index = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path}: {error}") from error
    if not isinstance(index, dict) or index.get("version") != _VERSION:
        raise DatasetError(f"{path}: not an index of format version {_VERSION}")
    names = {field.name for field in fields(Session)}
    rows = index.get("sessions")
    if not isinstance(rows, list) or not all(_is_row(row, names) for row in rows):
        raise DatasetError(f"{path}: a session needs {', '.join(sorted(names))}")
    return [Session(**row) for row in rows]


def _is_row(row: Any, names: set[str]) -> bool:
    return (
        isinstance(row, dict)
        and row.keys() == names
        and all(isinstance(value, str) and "/" not in value for value in row.values())
    )


def _label_place(
    folder: Path, sessions: Sequence[Session], config: LabelConfig
) -> tuple[dict[str, Int64], LabelCounts]:
    def joined(name: str) -> Any:
        return np.concatenate([read_array(folder, session, name) for session in sessions])

    sizes = [len(read_array(folder, session, "lengths")) for session in sessions]
    centroids = joined("centroids")
    labels = label_objects(centroids, joined("extents"), config)
    numbers = np.repeat(np.arange(len(sessions)), sizes)
    count = count_labels(labels, numbers, centroids, joined("objects"), FAR_M)
    parts = np.split(labels, np.cumsum(sizes)[:-1])
    return {s.file: part for s, part in zip(sessions, parts, strict=True)}, count


def _total(counts: Iterable[LabelCounts]) -> LabelCounts:
    rows = list(counts)
    again = sum(c.seen_again for c in rows)
    known = [c for c in rows if not np.isnan(c.agreeing)]
    across = sum(c.matching_across for c in known)
    return LabelCounts(
        sum(c.segments for c in rows),
        sum(c.objects for c in rows),
        again,
        sum(c.views * c.seen_again for c in rows) / max(again, 1),
        sum(c.matching for c in rows),
        sum(c.matching_across for c in rows),
        sum(c.different for c in rows),
        sum(c.agreeing * c.matching_across for c in known) / across if across else float("nan"),
    )


def load_dataset(path: Path) -> SegmentDataset:
    """Read a dataset: a folder of shards, or one file of :meth:`SegmentDataset.save`."""
    if path.is_file():
        return SegmentDataset.load(path)
    if not (path / INDEX).is_file():
        raise DatasetError(f"{path}: not a dataset: no {INDEX} in it")
    sessions = _listed(path)
    if not sessions:
        raise DatasetError(f"{path}: the dataset is empty")
    labels, _ = read_arrays(path / _LABELS)
    places = sorted({session.place for session in sessions})
    parts = [
        _place(path, [session for session in sessions if session.place == place], labels)
        for place in places
    ]
    return SegmentDataset.concatenate(parts)


def _place(path: Path, sessions: Sequence[Session], labels: dict[str, Int64]) -> SegmentDataset:
    """Return all sessions of one place with their common labels."""
    names = tuple(sorted({session.sensor for session in sessions}))
    parts = [_session(path, session, names, labels) for session in sessions]
    joined = SegmentDataset.concatenate(parts)  # numbers the sessions; labels are common already
    together = np.concatenate([part.labels for part in parts])
    return replace(joined, labels=together, places=np.zeros(len(joined), np.int64))


def _session(
    path: Path,
    session: Session,
    sensor_names: tuple[str, ...],
    labels: dict[str, Int64],
) -> SegmentDataset:
    names = [f.name for f in fields(Extract) if f.name not in ("structure", "extents")]
    arrays, _ = read_arrays(path / session.file, names)
    P = len(arrays["lengths"])
    own = labels.get(session.file)
    if own is None or len(own) != P:
        raise DatasetError(f"{path / session.file}: its labels are missing or do not match")
    dataset = SegmentDataset(
        labels=own,
        sessions=np.zeros(P, np.int64),
        places=np.zeros(P, np.int64),
        sensors=np.full(P, sensor_names.index(session.sensor), np.int64),
        sensor_names=sensor_names,
        **arrays,
    )
    return dataset.checked(path / session.file)
