"""Labelled segments: what networks and forests are trained on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from ..errors import DatasetError
from ..types import Float32, Float64, Int64, Segments

FAR_M = 20.0
"""Segments of one town count as different objects only beyond this distance, as in SegMap."""


@dataclass(frozen=True)
class SegmentDataset:
    """P raw segments with the objects that they show.

    Attributes
    ----------
    points : (M, 3) float32
        Raw points of all segments, local frames, metres.
    offsets : (P + 1,) int64
    labels : (P,) int64
        Segments with the same label show the same object.
    sessions : (P,) int64
        Which recording a segment is from.
    places : (P,) int64
        Which world a segment is from: segments of different worlds are never the same.
    centroids : (P, 3) float64
        In the frame of the world.
    heights : (P,) float32
        Height of each centroid above the ground below it, metres.
    """

    points: Float32
    offsets: Int64
    labels: Int64
    sessions: Int64
    places: Int64
    centroids: Float64
    heights: Float32

    def __len__(self) -> int:
        return len(self.labels)

    def segment(self, index: int) -> Float32:
        """The (n, 3) points of one segment."""
        return self.points[self.offsets[index] : self.offsets[index + 1]]

    def segments(self, indices: NDArray[np.integer] | None = None) -> Segments:
        """Some segments (all by default) as the descriptors take them."""
        chosen = np.arange(len(self)) if indices is None else indices
        parts = [self.segment(int(i)) for i in chosen]
        points = np.concatenate(parts) if parts else np.empty((0, 3), np.float32)
        offsets = np.cumsum([0, *(len(part) for part in parts)], dtype=np.int64)
        return Segments(points, offsets, self.centroids[chosen], self.heights[chosen])

    def subset(self, indices: NDArray[np.integer]) -> SegmentDataset:
        """The named segments as a dataset of their own."""
        packed = self.segments(indices)
        return SegmentDataset(
            packed.points,
            packed.offsets,
            self.labels[indices],
            self.sessions[indices],
            self.places[indices],
            self.centroids[indices],
            self.heights[indices],
        )

    def different(
        self, a: NDArray[np.integer], b: NDArray[np.integer], far_m: float = FAR_M
    ) -> NDArray[np.bool_]:
        """Whether the segments of `a` and of `b` (broadcast) surely show different objects."""
        apart = np.linalg.norm(self.centroids[a] - self.centroids[b], axis=-1) > far_m
        result: NDArray[np.bool_] = (self.labels[a] != self.labels[b]) & (
            apart | (self.places[a] != self.places[b])
        )
        return result

    def split(self, share: float, seed: int) -> tuple[SegmentDataset, SegmentDataset]:
        """Training and validation sets; whole worlds go to one side where there are several."""
        groups = self.places if len(np.unique(self.places)) > 2 else self.labels
        names = np.unique(groups)
        rng = np.random.default_rng(seed)
        held = rng.permutation(names)[: max(1, round(share * len(names)))]
        inside = np.isin(groups, held)
        return self.subset(np.flatnonzero(~inside)), self.subset(np.flatnonzero(inside))

    def save(self, path: Path) -> None:
        """Write a safetensors file."""
        path.parent.mkdir(parents=True, exist_ok=True)
        save_file({f.name: np.ascontiguousarray(getattr(self, f.name)) for f in fields(self)}, path)

    @staticmethod
    def load(path: Path) -> SegmentDataset:
        """Read what `save` wrote.

        Raises
        ------
        DatasetError
            If the file cannot be read or its arrays do not fit together.
        """
        try:
            dataset = SegmentDataset(**load_file(path))
        except (OSError, SafetensorError, TypeError) as error:
            raise DatasetError(f"{path}: {error}") from error
        P, M = len(dataset), len(dataset.points)
        shapes = {
            "points": (M, 3),
            "offsets": (P + 1,),
            "sessions": (P,),
            "places": (P,),
            "centroids": (P, 3),
            "heights": (P,),
        }
        for name, shape in shapes.items():
            if getattr(dataset, name).shape != shape:
                raise DatasetError(f"{path}: {name} does not have shape {shape}")
        offsets = dataset.offsets
        if offsets[0] != 0 or offsets[-1] != M or (np.diff(offsets) < 0).any():
            raise DatasetError(f"{path}: offsets do not fit the points")
        return dataset

    @staticmethod
    def concatenate(parts: Sequence[SegmentDataset]) -> SegmentDataset:
        """All parts in one; labels, sessions and places of different parts stay apart."""
        if not parts:
            raise DatasetError("no dataset to concatenate")

        def shifted(name: str) -> Int64:
            result, start = [], 0
            for part in parts:
                values: Int64 = getattr(part, name)
                result.append(values + start)
                start += int(values.max(initial=-1)) + 1
            return np.concatenate(result)

        starts = np.cumsum([0, *(len(part.points) for part in parts)])
        offsets = [
            part.offsets[:-1] + start for part, start in zip(parts, starts[:-1], strict=True)
        ]
        return SegmentDataset(
            np.concatenate([part.points for part in parts]),
            np.concatenate([*offsets, starts[-1:]]).astype(np.int64),
            shifted("labels"),
            shifted("sessions"),
            shifted("places"),
            np.concatenate([part.centroids for part in parts]),
            np.concatenate([part.heights for part in parts]),
        )
