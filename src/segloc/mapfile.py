"""The ``.segmap`` file: arrays in safetensors layout, with a version and checksums.

The layout is that of https://github.com/huggingface/safetensors: a length, a JSON header, and raw
little-endian buffers, so a map can be opened by any safetensors reader and never runs code. The
header's ``__metadata__`` holds the format version, the map's own text fields, a BLAKE2b-128
checksum of every array, and one of the header itself.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from .errors import MapFormatError
from .files import replacing

FORMAT_VERSION = 1
"""Raised whenever an older reader would misread a newer file."""

Array = NDArray[Any]

# Name -> dtype and shape. A letter stands for a length that must agree wherever it occurs.
SCHEMA: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "origin": ("F64", (3,)),
    "centroids": ("F64", ("P", 3)),
    "stamps": ("F64", ("P",)),
    "trajectory": ("F64", ("V", 4, 4)),
    "vectors": ("F32", ("P", "D")),
    "quality": ("F32", ("P",)),
    "cloud": ("F32", ("N", 3)),
    "sizes": ("I32", ("P",)),
    "session": ("I32", ("P",)),
    "missed": ("I32", ("P",)),
}
OPTIONAL = frozenset({"quality", "missed"})
REQUIRED_FIELDS = ("descriptor", "fingerprint", "cloud_voxel", "metadata")

_DTYPES = {"F64": "<f8", "F32": "<f4", "I32": "<i4"}
_VERSION, _CHECKSUM = "segmap_version", "checksum"


def write(path: str | Path, arrays: Mapping[str, Array], fields: Mapping[str, str]) -> None:
    """Write a map file: whole or not at all, and the same bytes for the same map.

    Parameters
    ----------
    path : str or Path
    arrays : mapping
        The arrays of ``SCHEMA``.
    fields : mapping
        The text fields of ``REQUIRED_FIELDS``.

    Raises
    ------
    SeglocError
        If the file cannot be written.
    """
    data = {
        name: np.ascontiguousarray(arrays[name], dtype=_DTYPES[dtype])
        for name, (dtype, _) in SCHEMA.items()  # widest first, which keeps every buffer aligned
        if name in arrays
    }
    shapes = {name: (SCHEMA[name][0], list(array.shape)) for name, array in data.items()}
    texts = {**fields, _VERSION: str(FORMAT_VERSION)}
    texts |= {f"{_CHECKSUM}.{name}": _digest(array) for name, array in data.items()}
    texts[_CHECKSUM] = _header_digest(texts, shapes)
    with replacing(path) as stream:
        stream.write(_header(texts, shapes, {name: array.nbytes for name, array in data.items()}))
        for array in data.values():
            stream.write(array.reshape(-1).view(np.uint8).data)


def read(path: str | Path) -> tuple[dict[str, Array], dict[str, str]]:
    """Read a map file: its arrays and its text fields.

    Sizes are checked against the length of the file before any array is allocated.

    Raises
    ------
    MapFormatError
        If there is no such file, or it is truncated, corrupt, newer, or no map; one line.
    """
    try:
        if not Path(path).is_file():
            kind = "is not a regular file" if Path(path).exists() else "no such file"
            raise MapFormatError(f"{path}: {kind}")
        # The package checks that header and buffers cover the file exactly, without a gap.
        with safe_open(path, framework="numpy") as file:
            return _read_checked(path, file)
    except SafetensorError as error:
        fault = str(error).splitlines()[0] if str(error) else "unreadable header"
        raise MapFormatError(f"{path}: not a map, or a damaged one ({fault})") from error
    except OSError as error:
        raise MapFormatError(f"{path}: cannot be read: {error}") from error


def _read_checked(path: str | Path, file: Any) -> tuple[dict[str, Array], dict[str, str]]:
    texts: dict[str, str] = file.metadata() or {}
    _check_version(path, texts)
    shapes: dict[str, tuple[str, list[int]]] = {}
    for name in file.keys():  # noqa: SIM118 (not a mapping)
        part = file.get_slice(name)
        shapes[name] = (part.get_dtype(), part.get_shape())
    if texts.get(_CHECKSUM) != _header_digest(texts, shapes):
        raise MapFormatError(f"{path}: damaged: the header does not match its checksum")
    _check_shapes(path, shapes)
    _check_fields(path, texts)
    arrays: dict[str, Array] = {}
    for name in shapes:
        arrays[name] = file.get_tensor(name)
        if texts.get(f"{_CHECKSUM}.{name}") != _digest(arrays[name]):
            raise MapFormatError(f"{path}: damaged: {name} does not match its checksum")
    return arrays, {key: texts[key] for key in REQUIRED_FIELDS}


def _check_version(path: str | Path, texts: Mapping[str, str]) -> None:
    version = texts.get(_VERSION, "")
    if not (version.isascii() and version.isdigit() and len(version) < 10):
        raise MapFormatError(f"{path}: not a segloc map")
    if int(version) > FORMAT_VERSION:
        raise MapFormatError(
            f"{path}: written by a newer segloc (map format {int(version)}, "
            f"this version reads up to {FORMAT_VERSION})"
        )


def _check_shapes(path: str | Path, shapes: Mapping[str, tuple[str, list[int]]]) -> None:
    missing = SCHEMA.keys() - OPTIONAL - shapes.keys()
    unknown = shapes.keys() - SCHEMA.keys()
    if missing or unknown:
        fault = "lacks" if missing else "has unknown"
        raise MapFormatError(f"{path}: {fault} {', '.join(sorted(missing or unknown))}")
    lengths: dict[str, int] = {}
    for name, (dtype, shape) in shapes.items():
        wanted_dtype, wanted = SCHEMA[name]
        resolved = [lengths.get(d, d) if isinstance(d, str) else d for d in wanted]
        fits = len(shape) == len(wanted) and all(
            isinstance(w, str) or w == s for w, s in zip(resolved, shape, strict=True)
        )
        if dtype != wanted_dtype or not fits:
            text = ", ".join(str(d) for d in resolved)
            raise MapFormatError(
                f"{path}: {name} is {dtype} {tuple(shape)}, not {wanted_dtype} ({text})"
            )
        for d, size in zip(wanted, shape, strict=True):
            if isinstance(d, str):
                lengths[d] = size


def _check_fields(path: str | Path, texts: Mapping[str, str]) -> None:
    missing = [key for key in REQUIRED_FIELDS if key not in texts]
    if missing:
        raise MapFormatError(f"{path}: lacks {', '.join(missing)}")


def _header(
    texts: Mapping[str, str],
    shapes: Mapping[str, tuple[str, list[int]]],
    sizes: Mapping[str, int],
) -> bytes:
    # Written here because the package orders the metadata at random: equal maps, equal bytes.
    header: dict[str, Any] = {"__metadata__": dict(sorted(texts.items()))}
    begin = 0
    for name, (dtype, shape) in shapes.items():
        end = begin + sizes[name]
        header[name] = {"dtype": dtype, "shape": shape, "data_offsets": [begin, end]}
        begin = end
    encoded = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    encoded += b" " * (-len(encoded) % 8)
    return len(encoded).to_bytes(8, "little") + encoded


def _header_digest(texts: Mapping[str, str], shapes: Mapping[str, tuple[str, list[int]]]) -> str:
    covered = {key: value for key, value in texts.items() if key != _CHECKSUM}
    encoded = json.dumps([covered, dict(shapes)], sort_keys=True).encode()
    return hashlib.blake2b(encoded, digest_size=16).hexdigest()


def _digest(array: Array) -> str:
    return hashlib.blake2b(np.ascontiguousarray(array).data, digest_size=16).hexdigest()
