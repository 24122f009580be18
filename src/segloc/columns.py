"""The arrays of a map: one row a segment, checked on the way in, joined when asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import SeglocError

Array = NDArray[Any]

SEGMENT_DTYPES: dict[str, Any] = {
    "vectors": np.float32,
    "quality": np.float32,
    "centroids": np.float64,
    "sizes": np.int32,
    "session": np.int32,
    "stamps": np.float64,
    "missed": np.int32,
}


def joined(parts: list[Array]) -> Array:
    """The parts as one array, which takes their place in the list."""
    if len(parts) > 1:
        parts[:] = [np.concatenate(parts)]
    return parts[0]


def row_shape(name: str, count: int, dim: int) -> tuple[int, ...]:
    """The shape of a column of ``count`` segments."""
    return {"vectors": (count, dim), "centroids": (count, 3)}.get(name, (count,))


def checked(values: ArrayLike, name: str, shape: tuple[int, ...], dtype: Any) -> Array:
    """A copy of ``values`` in that dtype.

    Raises
    ------
    SeglocError
        If the shape or the kind of dtype is wrong, or a value is not finite or does not fit.
    """
    array = np.asarray(values)
    if array.shape != shape:
        raise SeglocError(f"{name} must have shape {shape}, not {array.shape}")
    whole = np.issubdtype(dtype, np.integer)
    if array.size and array.dtype.kind not in ("iu" if whole else "iuf"):
        raise SeglocError(f"{name} cannot have dtype {array.dtype}")
    if not np.isfinite(array).all() or (whole and (np.abs(array) > np.iinfo(dtype).max).any()):
        raise SeglocError(f"{name} has values that are out of range")
    return np.array(array, dtype=dtype)
