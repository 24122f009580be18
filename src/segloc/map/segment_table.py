"""Segments of a map as checked columns, joined on access."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MapMismatch, SeglocError
from ..types import Descriptors, Float32, Float64
from .coding import Coded, Part, Stored, array_of
from .contents import column_fault

Array = NDArray[Any]
Int32 = NDArray[np.int32]

SEGMENT_DTYPES: dict[str, Any] = {
    "vectors": np.float32,
    "quality": np.float32,
    "centroids": np.float64,
    "sizes": np.int32,
    "session": np.int32,
    "stamps": np.float64,
    "missed": np.int32,
}


def joined(parts: list[Part]) -> Array:
    """Join the parts into one array, which replaces them in the list if there are several."""
    arrays = [array_of(part) for part in parts]
    if len(arrays) > 1:
        arrays = [np.concatenate(arrays)]
        parts[:] = arrays
    return arrays[0]


def bytes_of(parts: list[Part]) -> int:
    """Return the memory that the parts take."""
    return sum(part.nbytes for part in parts)


def row_shape(name: str, count: int, dim: int) -> tuple[int, ...]:
    """Return the shape of a column of ``count`` segments."""
    return {"vectors": (count, dim), "centroids": (count, 3)}.get(name, (count,))


def checked(values: ArrayLike, name: str, shape: tuple[int, ...], dtype: Any) -> Array:
    """Return a copy of ``values`` in that dtype.

    Raises
    ------
    SeglocError
        If the shape or kind of dtype is wrong, or a value is not finite or out of range.
    """
    array = np.asarray(values)
    if array.shape != shape:
        raise SeglocError(f"{name} must have shape {shape}, not {array.shape}")
    whole = np.issubdtype(dtype, np.integer)
    if array.size and array.dtype.kind not in ("iu" if whole else "iuf"):
        raise SeglocError(f"{name} cannot have dtype {array.dtype}")
    if not np.isfinite(array).all() or (whole and (np.abs(array) > np.iinfo(dtype).max).any()):
        raise SeglocError(f"{name} has values out of range")
    return np.array(array, dtype=dtype)


def no_segments(dim: int) -> dict[str, Array]:
    """Return empty columns."""
    return {
        name: np.empty(row_shape(name, 0, dim), dtype)
        for name, dtype in SEGMENT_DTYPES.items()
        if name != "quality"
    }


class SegmentTable:
    """Described segments, one per row.

    Parameters
    ----------
    columns : dict of str to array
        Columns of ``SEGMENT_DTYPES`` of equal length; "quality" and "missed" are optional.
    stored : dict of str to Stored, optional
        Columns that are unpacked on use.

    Attributes
    ----------
    dim : int
        Length of a vector.
    """

    def __init__(
        self, columns: Mapping[str, Array], stored: Mapping[str, Stored] | None = None
    ) -> None:
        self.dim = int(columns["vectors"].shape[1])
        # Rows are gathered in lists and joined on access. Whether there is a quality is unknown
        # until the first segments are added.
        self._columns: dict[str, list[Part]] = {
            name: [(stored or {}).get(name, array)]
            for name, array in columns.items()
            if name != "quality" or len(array)
        }
        self._columns.setdefault("missed", [np.zeros(len(columns["session"]), np.int32)])

    def __len__(self) -> int:
        return len(self.centroids)

    @property
    def vectors(self) -> Float32:
        """Descriptors, (P, dim) float32."""
        return self._column("vectors")

    @property
    def quality(self) -> Float32 | None:
        """Probability that a descriptor's nearest neighbour is right, (P,) float32, or None."""
        return self._column("quality") if "quality" in self._columns else None

    @property
    def centroids(self) -> Float64:
        """Means of the segments, (P, 3) float64, map frame."""
        return self._column("centroids")

    @property
    def sizes(self) -> Int32:
        """Points in each segment, (P,) int32."""
        return self._column("sizes")

    @property
    def session(self) -> Int32:
        """Session number of each segment, (P,) int32."""
        return self._column("session")

    @property
    def stamps(self) -> Float64:
        """Stamp of the view of each segment, (P,) float64."""
        return self._column("stamps")

    @property
    def missed(self) -> Int32:
        """Number of consecutive sessions that looked through each segment, (P,) int32."""
        return self._column("missed")

    @property
    def coded_vectors(self) -> Coded | None:
        """The descriptors as integers of a lattice, if they are stored so."""
        first, *others = self._columns["vectors"]
        return first if isinstance(first, Coded) and not others else None

    def _column(self, name: str) -> Array:
        return joined(self._columns[name])

    def columns(self) -> dict[str, Array]:
        """All columns, by the names of ``SEGMENT_DTYPES``."""
        return {name: self._column(name) for name in self._columns}

    def _rows_of(
        self,
        descriptors: Descriptors,
        centroids: ArrayLike,
        sizes: ArrayLike,
        session: int,
        stamp: float,
    ) -> dict[str, Array]:
        """Return the checked columns of a view; see `SegmentMap.add`."""
        count = len(descriptors)
        values: dict[str, ArrayLike | None] = {
            "vectors": descriptors.vectors,
            "quality": descriptors.quality,
            "centroids": centroids,
            "sizes": sizes,
            "session": np.full(count, session),
            "stamps": np.full(count, stamp, dtype=np.float64),
            "missed": np.zeros(count, np.int32),
        }
        columns = {
            name: checked(value, name, row_shape(name, count, self.dim), SEGMENT_DTYPES[name])
            for name, value in values.items()
            if value is not None
        }
        for name, column in columns.items():
            if fault := column_fault(name, column):
                raise SeglocError(fault)
        if count and len(self) and ("quality" in columns) != ("quality" in self._columns):
            raise MapMismatch("descriptor quality must be given for all views of a map or for none")
        return columns

    def _append(self, columns: Mapping[str, Array]) -> None:
        if len(columns["session"]):
            for name, array in columns.items():
                self._columns.setdefault(name, []).append(array)
