"""Labelled segments for training networks and forests."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from segloc.errors import DatasetError
from segloc.system import tensor_file
from segloc.system.files import replacing
from segloc.system.tensor_file import TensorFileError
from segloc.types import Float32, Float64, Int64, Segments

FAR_M = 20.0
"""Segments of one town farther apart show different objects, as in SegMap [m]."""

_UNKNOWN = np.empty(0)
_SQUARE_M = 100.0


@dataclass(frozen=True)
class SegmentDataset:
    """P raw segments with labels of the objects they show.

    Attributes
    ----------
    points : (M, 3) float32 or float16
        Raw points of all segments, local frames [m]; from shards in half precision about the
        centroids.
    offsets : (P + 1,) int64
    labels : (P,) int64
        Segments with the same label show the same object.
    sessions : (P,) int64
        Recording of each segment.
    places : (P,) int64
        World of each segment; segments of different worlds show different objects.
    centroids : (P, 3) float64
        In the frame of the world.
    heights : (P,) float32
        Height of each centroid above ground [m].
    lengths : (P,) float32
        Length of each segment's local cloud along the trajectory [m]; 0 for single scans.
    sensors : (P,) int64
        Index into ``sensor_names``.
    objects : (P,) int64
        True object, if simulated; else -1. Unique within a place.
    """

    points: Float32 | NDArray[np.float16]
    offsets: Int64
    labels: Int64
    sessions: Int64
    places: Int64
    centroids: Float64
    heights: Float32
    lengths: Float32 = field(default_factory=lambda: _UNKNOWN.astype(np.float32))
    sensors: Int64 = field(default_factory=lambda: _UNKNOWN.astype(np.int64))
    objects: Int64 = field(default_factory=lambda: _UNKNOWN.astype(np.int64))
    sensor_names: tuple[str, ...] = ("unknown",)

    def __post_init__(self) -> None:
        for name, value in (("lengths", 0.0), ("sensors", 0), ("objects", -1)):
            array = getattr(self, name)
            if len(array) != len(self):
                object.__setattr__(self, name, np.full(len(self), value, array.dtype))

    def __len__(self) -> int:
        return len(self.labels)

    def digest(self) -> bytes:
        """Return a digest of all of it."""
        digest = hashlib.sha256()
        for each in fields(self):
            value = getattr(self, each.name)
            digest.update(
                value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()
            )
        return digest.digest()

    def segment(self, index: int) -> Float32:
        """Return the (n, 3) points of one segment, float32."""
        part = self.points[self.offsets[index] : self.offsets[index + 1]]
        return part.astype(np.float32, copy=False)

    def segments(self, indices: NDArray[np.integer] | None = None) -> Segments:
        """Return some segments (by default all) for the descriptors."""
        chosen = np.arange(len(self)) if indices is None else indices
        points, offsets = packed([self.segment(int(i)) for i in chosen])
        if len(chosen) == 0:
            return Segments(points, offsets, np.empty((0, 3)), self.heights[chosen])
        centroids = np.add.reduceat(points, offsets[:-1], dtype=np.float64)
        centroids /= np.diff(offsets)[:, None]
        return Segments(points, offsets, centroids, self.heights[chosen])

    def subset(self, indices: NDArray[np.integer]) -> SegmentDataset:
        """Return some segments as a dataset."""
        points, offsets = packed([self.segment(int(i)) for i in indices])
        chosen = {name: getattr(self, name)[indices] for name in _PER_SEGMENT}
        return SegmentDataset(points, offsets, sensor_names=self.sensor_names, **chosen)

    def different(
        self, a: NDArray[np.integer], b: NDArray[np.integer], far_m: float = FAR_M
    ) -> NDArray[np.bool_]:
        """Return whether segments of ``a`` and ``b`` (broadcast) surely show different objects."""
        apart = np.linalg.norm(self.centroids[a] - self.centroids[b], axis=-1) > far_m
        apart |= self.places[a] != self.places[b]
        return apart & (self.labels[a] != self.labels[b])

    def limited(self, limit: int, seed: int) -> SegmentDataset:
        """Return at most ``limit`` segments, of complete objects except the last."""
        if len(self) <= limit:
            return self
        rng = np.random.default_rng(seed)
        names = rng.permutation(np.unique(self.labels))
        rank = np.empty(int(names.max()) + 1, np.int64)
        rank[names] = np.arange(len(names))
        order = np.argsort(rank[self.labels], kind="stable")[:limit]
        return self.subset(np.sort(order))

    def split(self, share: float, seed: int) -> tuple[SegmentDataset, SegmentDataset]:
        """Split into training and validation sets.

        Whole worlds go to one side if at least three were visited twice; validation gets worlds of
        that kind. Otherwise objects are split by squares of 100 m.
        """
        groups, names = self._split_groups()
        rng = np.random.default_rng(seed)
        held = rng.permutation(names)[: max(1, round(share * len(names)))]
        inside = np.isin(groups, held)
        return self.subset(np.flatnonzero(~inside)), self.subset(np.flatnonzero(inside))

    def _split_groups(self) -> tuple[Int64, Int64]:
        """Return the group of each segment, and the groups available for validation."""
        pairs = np.unique(np.column_stack([self.places, self.sessions]), axis=0)
        worlds, sessions = np.unique(pairs[:, 0], return_counts=True)
        again = worlds[sessions > 1]
        if len(again) > 2:
            return self.places, again
        _, first, number = np.unique(self.labels, return_index=True, return_inverse=True)
        squares = np.floor(self.centroids[first, :2] / _SQUARE_M)
        keys = np.column_stack([self.places[first], squares])
        _, square = np.unique(keys, axis=0, return_inverse=True)
        groups = square.reshape(-1)[number.reshape(-1)].astype(np.int64)
        across = np.unique(groups[np.isin(self.places, again)]) if len(again) else groups
        names = np.unique(across)
        return (groups, names) if len(names) > 1 else (self.labels, np.unique(self.labels))

    def save(self, path: Path) -> None:
        """Write a safetensors file."""
        path.parent.mkdir(parents=True, exist_ok=True)
        arrays = {name: getattr(self, name) for name in ("points", "offsets", *_PER_SEGMENT)}
        names = json.dumps(self.sensor_names)
        with replacing(path) as stream:
            tensor_file.write_tensors(stream, arrays, {"sensor_names": names})

    @staticmethod
    def load(path: Path) -> SegmentDataset:
        """Read the output of `save`."""
        arrays, metadata = read_arrays(path)
        try:
            names = json.loads(metadata.get("sensor_names", '["unknown"]'))
            dataset = SegmentDataset(**arrays, sensor_names=tuple(names))
        except (TypeError, ValueError) as error:
            raise DatasetError(f"{path}: not a dataset: {error}") from error
        return dataset.checked(path)

    def checked(self, path: Path) -> SegmentDataset:
        """Return the dataset if its arrays are consistent and not empty."""
        P, M = len(self), len(self.points)
        if P == 0:
            raise DatasetError(f"{path}: the dataset is empty")
        shapes = {"points": (M, 3), "offsets": (P + 1,), "centroids": (P, 3)}
        for name in ("points", "offsets", *_PER_SEGMENT):
            shape, kind = shapes.get(name, (P,)), "f" if name in _REAL else "i"
            array = getattr(self, name)
            if array.shape != shape or array.dtype.kind != kind:
                raise DatasetError(f"{path}: {name} has the wrong shape or type, not {shape}")
        if self.offsets[0] != 0 or self.offsets[-1] != M or (np.diff(self.offsets) <= 0).any():
            raise DatasetError(f"{path}: offsets do not match the points")
        if self.sensors.min() < 0 or self.sensors.max() >= len(self.sensor_names):
            raise DatasetError(f"{path}: a segment's sensor has no name")
        return self

    @staticmethod
    def concatenate(parts: Sequence[SegmentDataset]) -> SegmentDataset:
        """Concatenate datasets; labels, sessions and places stay separate."""
        if not parts:
            raise DatasetError("no datasets to concatenate")

        def shifted(name: str) -> Int64:
            result, start = [], 0
            for part in parts:
                values: Int64 = getattr(part, name)
                result.append(values + start)
                start += int(values.max(initial=-1)) + 1
            return np.concatenate(result)

        sizes = np.concatenate([np.diff(part.offsets) for part in parts])
        names = tuple(dict.fromkeys(name for part in parts for name in part.sensor_names))
        sensors = [
            np.array([names.index(name) for name in part.sensor_names])[part.sensors]
            for part in parts
        ]
        joined = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("points", "centroids", "heights", "lengths", "objects")
        }
        return SegmentDataset(
            **joined,
            offsets=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
            labels=shifted("labels"),
            sessions=shifted("sessions"),
            places=shifted("places"),
            sensors=np.concatenate(sensors).astype(np.int64),
            sensor_names=names,
        )


def read_arrays(
    path: Path, names: Iterable[str] | None = None
) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Read arrays of a safetensors file, by default all, and its metadata.

    The file is not memory-mapped, since it may shrink while being written.
    """
    try:
        with tensor_file.open_tensor_file(path) as file:
            wanted = file.tensors if names is None else names
            return {name: file.read(name) for name in wanted}, file.metadata
    except KeyError as error:
        raise DatasetError(f"{path}: not a dataset: no array {error}") from error
    except (OSError, TensorFileError) as error:
        raise DatasetError(f"{path}: not a dataset: {error}") from error


def chunks(count: int, size: int) -> Iterator[Int64]:
    """Yield the numbers below ``count``, at most ``size`` at once."""
    for first in range(0, count, size):
        yield np.arange(first, min(first + size, count))


def packed(parts: Sequence[Float32]) -> tuple[Float32, Int64]:
    """Concatenate segments to points (M, 3) and offsets (P + 1,)."""
    points = np.concatenate([np.empty((0, 3), np.float32), *parts])
    return points, np.cumsum([0, *(len(part) for part in parts)], dtype=np.int64)


_REAL = ("points", "centroids", "heights", "lengths")
_WHOLE = ("labels", "sessions", "places", "sensors", "objects")
_PER_SEGMENT = (*_WHOLE, "centroids", "heights", "lengths")
