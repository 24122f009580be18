"""Read and write NumPy's ``.npy`` and ``.npz``, without pickle."""

from __future__ import annotations

import io
import math
import re
import zipfile
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...system.budget import check_bytes, check_points, most_points
from ...types import Float32, Float64, Scan
from .fields import brief, require_bytes

_MAGIC = b"\x93NUMPY"
_DESCR = re.compile(r"'descr': *'([<>|=][fiu]\d{1,2})'")
_FORTRAN = re.compile(r"'fortran_order': *(True|False)")
_SHAPE = re.compile(r"'shape': *\(([\d, ]{0,200})\)")
_DEFLATE_RATIO = 1032  # maximum ratio of deflate


def parse_npy(data: bytes) -> Scan:
    """An array (N, >= 3) of numbers: x, y, z and whatever else."""
    return Scan(as_points(parse_array(data)))


def parse_npz(data: bytes) -> Scan:
    """Parse the array ``points``, or the only one besides ``times``; ``times`` (N,) is optional."""
    points, times = _parse_archive(data)
    return Scan(points, times=times)


def parse_coordinates(data: bytes) -> list[NDArray[Any]]:
    """Return the columns x, y and z of an archive as they are stored."""
    return list(_parse_archive(data)[0][:, :3].T)


def as_points(array: NDArray[Any]) -> NDArray[np.floating[Any]]:
    if array.ndim not in (2, 3) or array.shape[-1] < 3:
        raise DatasetError(f"points have shape {array.shape}, not (N, 3) or wider, or (H, W, 3)")
    array = array.reshape(-1, array.shape[-1])
    check_points(len(array))
    return array if array.dtype.kind == "f" else array.astype(np.float64)


def parse_array(data: bytes) -> NDArray[Any]:
    """The array of an NPY file; its header is matched as text, so nothing in it is evaluated."""
    if len(data) < 12 or not data.startswith(_MAGIC) or data[6] not in (1, 2):
        raise DatasetError("not an NPY file of version 1 or 2")
    width = 2 if data[6] == 1 else 4
    start = 8 + width + int.from_bytes(data[8 : 8 + width], "little")
    if start > len(data):
        raise DatasetError("the header is cut off")
    header = data[8 + width : start].decode("latin-1")
    descr, fortran, shape = (each.search(header) for each in (_DESCR, _FORTRAN, _SHAPE))
    if descr is None or fortran is None or shape is None:
        raise DatasetError(f"not an array of numbers: {' '.join(header.split())[:80]}")
    return _array_from(data, start, descr[1], shape[1], "F" if fortran[1] == "True" else "C")


def _array_from(
    data: bytes, start: int, descr: str, shape: str, order: Literal["C", "F"]
) -> NDArray[Any]:
    try:
        dtype = np.dtype(descr)
        sizes = tuple(int(size) for size in shape.split(",") if size.strip())
    except (TypeError, ValueError) as error:
        raise DatasetError(f"bad header: {error}") from error
    needed = math.prod(sizes) * dtype.itemsize
    require_bytes(len(data) - start, needed, f"values of shape {sizes}")
    if needed != len(data) - start:
        raise DatasetError(f"shape {sizes} needs {needed} bytes, but {len(data) - start} are left")
    if not needed:
        if max(sizes, default=0) > most_points():
            raise DatasetError(f"impossible shape {sizes}")
        return np.empty(sizes, dtype)
    return np.frombuffer(data, dtype, offset=start).reshape(sizes, order=order)


def _parse_archive(data: bytes) -> tuple[NDArray[np.floating[Any]], NDArray[Any] | None]:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            times = members.pop("times", None)
            if "points" not in members and len(members) != 1:
                raise DatasetError(
                    f"no array 'points'; arrays: {', '.join(members) or 'none'}"[:200]
                )
            name = "points" if "points" in members else next(iter(members))
            points = as_points(parse_array(_member(archive, members[name])))
            stamps = parse_array(_member(archive, times)) if times else None
    except DatasetError:
        raise
    except Exception as error:  # zipfile raises many kinds on damaged bytes
        raise DatasetError(f"not a readable NPZ archive: {brief(error)}") from error
    if stamps is not None and stamps.shape != (len(points),):
        raise DatasetError(f"times have shape {stamps.shape}, not ({len(points)},)")
    return points, stamps


def _member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise DatasetError(f"{info.filename}: unsupported compression")
    if info.file_size > _DEFLATE_RATIO * (info.compress_size + 1):
        raise DatasetError(f"{info.filename} cannot hold its declared {info.file_size} bytes")
    check_bytes(info.file_size, info.filename)
    return archive.read(info)


def format_npy(points: Float32) -> bytes:
    """Format the points as a float32 array (N, 3)."""
    buffer = io.BytesIO()
    np.save(buffer, points.astype("<f4"), allow_pickle=False)
    return buffer.getvalue()


def format_npz(points: Float32, times: Float64 | None) -> bytes:
    """Format an archive of ``points``, float32 (N, 3), and float64 ``times``, if any."""
    buffer = io.BytesIO()
    arrays = {} if times is None else {"times": times.astype("<f8")}
    np.savez(buffer, allow_pickle=False, points=points.astype("<f4"), **arrays)
    return buffer.getvalue()
