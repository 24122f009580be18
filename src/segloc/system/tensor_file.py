"""Files in safetensors layout, read and never mapped: a length, a JSON header, raw buffers.

A mapped file that is cut short by someone else ends the process that looks at it; a read comes
back short and can be refused. Whatever reads maps or weights hashes them whole anyway.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import FileIO
from math import prod
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

MAX_HEADER_BYTES = 16_000_000
"""A header is text that people wrote; a longer one would grow too much when it is parsed."""

_DTYPES = {
    **{"F64": "<f8", "F32": "<f4", "F16": "<f2", "BOOL": "|b1"},
    **{f"I{8 * size}": f"<i{size}" for size in (1, 2, 4, 8)},
    **{f"U{8 * size}": f"<u{size}" for size in (1, 2, 4, 8)},
}
_PART = 1 << 15  # numbers
_CUT_SHORT = "it was cut short while it was read"
_MAX_DIMENSIONS, _MAX_DIGITS, _MAX_SIZE = 8, 19, 1 << 62


class TensorFileError(Exception):
    """The file is not in this layout, damaged, or cut short while it is read; one line."""


@dataclass(frozen=True)
class Tensor:
    """Where a tensor lies, in bytes behind the header."""

    dtype: str
    shape: tuple[int, ...]
    begin: int
    end: int


class TensorFile:
    """An open file whose header was checked against the length of the file.

    Attributes
    ----------
    metadata : dict of str to str
    tensors : dict of str to Tensor
        In the order of their places. Together they cover the file behind the header.
    """

    def __init__(self, stream: FileIO) -> None:
        self._stream = stream
        length = os.fstat(stream.fileno()).st_size
        if length < 8:
            raise TensorFileError("header too small")
        size = int.from_bytes(self._bytes(8), "little")
        if size > min(length - 8, MAX_HEADER_BYTES):
            raise TensorFileError("header too large")
        self._body = 8 + size
        header = _parsed(self._bytes(size))
        self.metadata = _texts(header.pop("__metadata__", {}))
        found = {name: _tensor(name, entry) for name, entry in header.items()}
        self.tensors = dict(sorted(found.items(), key=lambda item: (item[1].begin, item[1].end)))
        self._check_cover(length - self._body)

    def read(self, name: str, look: Callable[[NDArray[Any]], None] | None = None) -> NDArray[Any]:
        """The tensor of that name, as an array of its own.

        ``look`` is shown its numbers part by part, each while the processor has it at hand.

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
                raise TensorFileError(f"{name} does not begin where the one before it ends")
            reached = tensor.end
        if reached != length:
            raise TensorFileError(f"its tensors need {reached} bytes, and it has {length}")


@contextmanager
def opened(path: str | Path) -> Iterator[TensorFile]:
    """A file in safetensors layout, open for reading.

    Raises
    ------
    TensorFileError
        If the header is damaged or does not fit the length of the file.
    OSError
    """
    with Path(path).open("rb", buffering=0) as stream:
        yield TensorFile(stream)


def _parsed(text: bytes) -> dict[str, Any]:
    try:
        header = json.loads(text.decode(), parse_int=_int, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise TensorFileError("the header is no JSON text") from error
    if not isinstance(header, dict):
        raise TensorFileError("the header is no JSON object")
    return header


def _int(digits: str) -> int:
    return int(digits) if len(digits) <= _MAX_DIGITS else _MAX_SIZE  # which no file has


def _refuse(constant: str) -> NoReturn:
    raise ValueError(constant)


def _texts(metadata: Any) -> dict[str, str]:
    if not (isinstance(metadata, Mapping) and all(isinstance(v, str) for v in metadata.values())):
        raise TensorFileError("the metadata are no texts")
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
