"""Files in safetensors layout: a length, a JSON header, raw buffers; never memory-mapped.

If a mapped file is truncated meanwhile, the process is killed; a short read can be rejected.
Readers of maps and weights hash them completely anyway.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO, FileIO
from math import prod
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

MAX_HEADER_BYTES = 16_000_000
"""Longer headers would take too much memory to parse."""

_DTYPES = {
    **{"F64": "<f8", "F32": "<f4", "F16": "<f2", "BOOL": "|b1"},
    **{f"I{8 * size}": f"<i{size}" for size in (1, 2, 4, 8)},
    **{f"U{8 * size}": f"<u{size}" for size in (1, 2, 4, 8)},
}
_NAMES = {np.dtype(dtype).str: name for name, dtype in _DTYPES.items()}
_PART = 1 << 15  # numbers
_CUT_SHORT = "it was truncated while being read"
_MAX_DIMENSIONS, _MAX_DIGITS, _MAX_SIZE = 8, 19, 1 << 62


class TensorFileError(Exception):
    """A file that is damaged, truncated, or in another layout; one line."""


@dataclass(frozen=True)
class Tensor:
    """Position of a tensor, in bytes after the header."""

    dtype: str
    shape: tuple[int, ...]
    begin: int
    end: int


class TensorFile:
    """Open file with a header checked against the file's length.

    Attributes
    ----------
    metadata : dict of str to str
    tensors : dict of str to Tensor
        In the order of their positions. Together they cover the file after the header.
    """

    def __init__(self, stream: FileIO | BytesIO) -> None:
        self._stream = stream
        length = stream.seek(0, os.SEEK_END)
        stream.seek(0)
        if length < 8:
            raise TensorFileError("header too small")
        size = int.from_bytes(self._bytes(8), "little")
        if size > min(length - 8, MAX_HEADER_BYTES):
            raise TensorFileError("header too large")
        self._body = 8 + size
        header = _parse(self._bytes(size))
        self.metadata = _texts(header.pop("__metadata__", {}))
        found = {name: _tensor(name, entry) for name, entry in header.items()}
        self.tensors = dict(sorted(found.items(), key=lambda item: (item[1].begin, item[1].end)))
        self._check_cover(length - self._body)

    def read(self, name: str, look: Callable[[NDArray[Any]], None] | None = None) -> NDArray[Any]:
        """Read a tensor as a new array.

        ``look`` is called with its numbers part by part, while they are in the processor's cache.

        Raises
        ------
        TensorFileError
            If the file has become shorter, or the tensor does not fit into memory.
        """
        tensor = self.tensors[name]
        try:
            array = np.empty(tensor.shape, _DTYPES[tensor.dtype])
        except (MemoryError, ValueError) as error:
            raise TensorFileError(f"{name} does not fit into memory") from error
        self._stream.seek(self._body + tensor.begin)
        flat = array.reshape(-1)
        for start in range(0, len(flat), _PART):
            part = flat[start : start + _PART]
            self._fill(part)
            if look:
                look(part)
        return array

    def _fill(self, part: NDArray[Any]) -> None:
        rest = part.view(np.uint8).data
        while len(rest):
            count = self._stream.readinto(rest)
            if not count:
                raise TensorFileError(_CUT_SHORT)
            rest = rest[count:]

    def _bytes(self, count: int) -> bytes:
        data = np.empty(count, np.uint8)
        self._fill(data)
        return data.tobytes()

    def _check_cover(self, length: int) -> None:
        reached = 0
        for name, tensor in self.tensors.items():
            if tensor.begin != reached:
                raise TensorFileError(f"{name} does not start where the previous tensor ends")
            reached = tensor.end
        if reached != length:
            raise TensorFileError(f"its tensors need {reached} bytes, the file has {length}")


@contextmanager
def open_tensor_file(path: str | Path) -> Iterator[TensorFile]:
    """Open a file in safetensors layout for reading.

    Raises
    ------
    TensorFileError
        If the header is damaged or does not match the length of the file.
    OSError
    """
    with Path(path).open("rb", buffering=0) as stream:
        yield TensorFile(stream)


def encoded_header(arrays: Mapping[str, NDArray[Any]], texts: Mapping[str, str]) -> bytes:
    """Encode the length and header of a file: equal contents give equal bytes, in any order.

    The buffers follow in the order of :func:`in_file_order`.
    """
    header: dict[str, Any] = {"__metadata__": dict(sorted(texts.items()))}
    begin, shapes = 0, shapes_of(arrays)
    for name in in_file_order(arrays):
        end = begin + arrays[name].nbytes
        dtype, shape = shapes[name]
        header[name] = {"dtype": dtype, "shape": shape, "data_offsets": [begin, end]}
        begin = end
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text


def shapes_of(arrays: Mapping[str, NDArray[Any]]) -> dict[str, tuple[str, list[int]]]:
    """Return dtype, as a file names it, and shape of each array."""
    return {
        name: (_NAMES[array.dtype.newbyteorder("<").str], list(array.shape))
        for name, array in arrays.items()
    }


def in_file_order(arrays: Mapping[str, NDArray[Any]]) -> list[str]:
    """Return the names of arrays, widest numbers first, so that buffers stay aligned."""
    return sorted(arrays, key=lambda name: -arrays[name].itemsize)


def write_tensors(
    stream: BinaryIO, arrays: Mapping[str, NDArray[Any]], texts: Mapping[str, str]
) -> None:
    """Write a file of arrays and texts."""
    stream.write(encoded_header(arrays, texts))
    for name in in_file_order(arrays):
        array = arrays[name]
        plain = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        stream.write(plain.reshape(-1).view(np.uint8).data)


def _parse(text: bytes) -> dict[str, Any]:
    try:
        header = json.loads(text.decode(), parse_int=_int, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise TensorFileError("the header is not JSON") from error
    if not isinstance(header, dict):
        raise TensorFileError("the header is not a JSON object")
    return header


def _int(digits: str) -> int:
    return int(digits) if len(digits) <= _MAX_DIGITS else _MAX_SIZE  # larger than any file


def _refuse(constant: str) -> NoReturn:
    raise ValueError(constant)


def _texts(metadata: Any) -> dict[str, str]:
    if not (isinstance(metadata, Mapping) and all(isinstance(v, str) for v in metadata.values())):
        raise TensorFileError("the metadata are not texts")
    return dict(metadata)


def _tensor(name: str, entry: Any) -> Tensor:
    try:
        dtype, shape, (begin, end) = entry["dtype"], tuple(entry["shape"]), entry["data_offsets"]
        known = len(entry) == 3 and dtype in _DTYPES and len(shape) <= _MAX_DIMENSIONS
    except (KeyError, TypeError, ValueError) as error:
        raise TensorFileError(f"the header's entry of {name[:40]!r} is damaged") from error
    numbers = (*shape, begin, end)
    whole = all(type(n) is int and 0 <= n < _MAX_SIZE for n in numbers)
    if not (known and whole):
        raise TensorFileError(f"the header's entry of {name[:40]!r} is damaged")
    if prod(shape) * np.dtype(_DTYPES[dtype]).itemsize != end - begin:
        raise TensorFileError(f"the size of {name[:40]!r} does not fit its shape")
    return Tensor(dtype, shape, begin, end)
