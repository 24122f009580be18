"""The ``.segmap`` file: arrays in safetensors layout, with a version and checksums.

The layout is that of https://github.com/huggingface/safetensors: a length, a JSON header, and raw
little-endian buffers, so any safetensors reader opens a map, and reading it runs no code. The
header's ``__metadata__`` holds the format version, the map's text fields, a BLAKE2b-128 checksum
of every array, and one of the header itself. In version 2 the arrays are packed (:mod:`.coding`); a
map whose numbers lie on no lattice is written in version 1, unpacked.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import MapFormatError, SeglocError
from ..system.files import is_cloud, replacing
from ..system.tensor_file import (
    MAX_HEADER_BYTES,
    TensorFile,
    TensorFileError,
    encoded_header,
    open_tensor_file,
    shapes_of,
    write_tensors,
)
from .coding import (
    CodingError,
    Recipes,
    Stored,
    fault_of_growth,
    packed_arrays,
    recipes_of,
    stored_array,
    text_of,
)
from .contents import MAX_DIM, arrays_fault, column_fault, texts_fault, voxel_fault

FORMAT_VERSION = 2
"""To be increased when older readers would misread newer files."""
PLAIN, PACKED = 1, 2
"""Versions of files with plain and with packed arrays."""

Array = NDArray[Any]

REQUIRED_FIELDS = ("descriptor", "fingerprint", "cloud_voxel", "metadata")

_DTYPES = {"F64": "<f8", "F32": "<f4", "I32": "<i4", "U8": "|u1"}
_VERSION, _CHECKSUM, _CODING = "segmap_version", "checksum", "coding"


class Tensor(NamedTuple):
    """Type and meaning of a tensor; equal letters in shapes are equal lengths."""

    dtype: str
    shape: tuple[str | int, ...]
    meaning: str


SCHEMA = {
    "origin": Tensor("F64", (3,), "map frame [m]; the cloud is relative to it"),
    "centroids": Tensor("F64", ("P", 3), "mean of each segment's points, map frame [m]"),
    "stamps": Tensor("F64", ("P",), "time of the segment's view [s]; scan number without times"),
    "trajectory": Tensor("F64", ("V", 4, 4), "T_map_sensor along the mapped trajectory [m]"),
    "vectors": Tensor("F32", ("P", "D"), "descriptors, compared by Euclidean distance"),
    "quality": Tensor("F32", ("P",), "probability of a correct match, 0 to 1; optional"),
    "cloud": Tensor("F32", ("N", 3), "one point per voxel, relative to `origin` [m]"),
    "sizes": Tensor("I32", ("P",), "points per segment"),
    "session": Tensor("I32", ("P",), "number of the session that saw the segment"),
    "missed": Tensor("I32", ("P",), "consecutive sessions without the segment; optional, 0"),
}
OPTIONAL = frozenset({"quality", "missed"})
FIELDS = {
    _VERSION: "format version, a decimal number",
    "descriptor": "name of the descriptor, as in `segloc.descriptors.available()`",
    "fingerprint": "hash of its weights and preprocessing; queries with another are rejected",
    "cloud_voxel": "edge of a voxel of the cloud [m], as Python's `repr` of a float",
    _CODING: "JSON object, in version 2 only: how each tensor is packed",
    "metadata": "JSON object of text to text: `config` (YAML of the build), `sequence`, `frame` (a "
    "sentence, if the frame is tilted or was levelled), `T_map_odom`, of a cloud `T_map_cloud` "
    "(JSON, 4 rows of 4 numbers, if levelled), `georeference`, and keys of users",
    _CHECKSUM: "checksum of the header",
    f"{_CHECKSUM}.NAME": "checksum of tensor NAME, one key per tensor",
}
"""Text fields of ``__metadata__`` and their meaning."""


@dataclass(frozen=True)
class Contents:
    """Contents of a map file.

    Attributes
    ----------
    arrays : mapping
        The arrays of ``SCHEMA``.
    descriptor, fingerprint : str
    cloud_voxel : float
        Voxel size of the cloud [m].
    metadata : dict of str to str
    stored : mapping
        Arrays of a packed file as they are stored.
    """

    arrays: Mapping[str, Array]
    descriptor: str
    fingerprint: str
    cloud_voxel: float
    metadata: Mapping[str, str]
    stored: Mapping[str, Stored] = field(default_factory=dict)

    def fault(self) -> str | None:
        """Return the fault of the values, with field and row; None if valid."""
        return (
            texts_fault(self.descriptor, self.fingerprint, self.metadata)
            or voxel_fault(self.cloud_voxel)
            or arrays_fault(self.arrays, self.cloud_voxel)
        )


def write(path: str | Path, contents: Contents) -> None:
    """Write a map file atomically; equal maps give equal bytes.

    Raises
    ------
    SeglocError
        If the file cannot be written, or :func:`read` would reject it.
    """
    data, texts = _encoded(path, contents)
    with replacing(path) as stream:
        write_tensors(stream, data, texts)


def to_bytes(name: str, contents: Contents) -> bytes:
    """Return the bytes of a map file; ``name`` is what errors call it."""
    stream = BytesIO()
    write_tensors(stream, *_encoded(name, contents))
    return stream.getvalue()


def _encoded(path: str | Path, contents: Contents) -> tuple[dict[str, Array], dict[str, str]]:
    """Return the arrays and texts of a file."""
    if fault := contents.fault():
        raise SeglocError(f"{path}: not written: {fault}")
    data = {
        name: np.ascontiguousarray(contents.arrays[name], dtype=_DTYPES[dtype])
        for name, (dtype, *_) in SCHEMA.items()
        if name in contents.arrays
    }
    texts = {
        "descriptor": contents.descriptor,
        "fingerprint": contents.fingerprint,
        "cloud_voxel": repr(contents.cloud_voxel),
        "metadata": json.dumps(dict(contents.metadata), sort_keys=True),
        _VERSION: str(PLAIN),
    }
    if found := packed_arrays(data, contents.cloud_voxel):
        data |= found[0]
        texts |= {_VERSION: str(PACKED), _CODING: text_of(found[1])}
    for name, array in data.items():
        texts[f"{_CHECKSUM}.{name}"] = hashlib.blake2b(array.data, digest_size=16).hexdigest()
    texts[_CHECKSUM] = _header_digest(texts, shapes_of(data))
    length = len(encoded_header(data, texts))
    if length > MAX_HEADER_BYTES:
        raise SeglocError(f"{path}: not written: metadata too long ({length} bytes)")
    return data, texts


def read(path: str | Path) -> Contents:
    """Read a map file.

    Sizes are checked against the length of the file before allocation, values after the checksums.
    The file is read, not memory-mapped: a file truncated meanwhile is rejected.

    Raises
    ------
    MapFormatError
        If the file is missing, truncated, corrupt, of a newer version, or no map, or a value is
        not finite or implausible; one line that names file, field and row.
    """
    with _described(path):
        if is_cloud(Path(path)) and Path(path).exists():
            raise MapFormatError(
                f"{path}: a point cloud, not a map: build a map from it with "
                "`segloc map from-cloud CLOUD --out MAP.segmap`"
            )
        if not Path(path).is_file():
            if Path(path).is_dir():
                raise MapFormatError(f"{path}: a folder, not a .segmap file")
            kind = "not a regular file" if Path(path).exists() else "no such file"
            raise MapFormatError(f"{path}: {kind}")
        with open_tensor_file(path) as file:
            return _read_checked(path, file)


def from_bytes(name: str, data: bytes) -> Contents:
    """Return the contents of a map file's bytes, as :func:`read`; errors call it ``name``."""
    with _described(name):
        return _read_checked(name, TensorFile(BytesIO(data)))


@contextmanager
def _described(path: str | Path) -> Iterator[None]:
    """Turn the faults of a file into those of a map."""
    try:
        yield
    except TensorFileError as error:
        raise MapFormatError(f"{path}: unreadable as a map ({error})") from error
    except OSError as error:
        raise MapFormatError(f"{path}: cannot be read: {error.strerror or error}") from error


def _read_checked(path: str | Path, file: TensorFile) -> Contents:
    texts = file.metadata
    version = _checked_version(path, texts)
    shapes = {name: (tensor.dtype, list(tensor.shape)) for name, tensor in file.tensors.items()}
    if texts.get(_CHECKSUM) != _header_digest(texts, shapes):
        raise MapFormatError(f"{path}: damaged: the header does not match its checksum")
    recipes = _recipes(path, texts, shapes) if version == PACKED else {}
    unpacked = shapes | {name: (SCHEMA[name][0], list(r.shape)) for name, r in recipes.items()}
    if fault := shapes_fault(unpacked):
        raise MapFormatError(f"{path}: {fault}")
    if missing := [key for key in REQUIRED_FIELDS if key not in texts]:
        raise MapFormatError(f"{path}: missing {', '.join(missing)}")
    arrays: dict[str, Array] = {}
    for name in shapes:
        digest = hashlib.blake2b(digest_size=16)
        arrays[name] = file.read(name, partial(_hash, digest))
        if texts.get(f"{_CHECKSUM}.{name}") != digest.hexdigest():
            raise MapFormatError(f"{path}: damaged: {name} does not match its checksum")
    contents = _contents(path, arrays, texts)
    if recipes:
        contents = _unpack(path, contents, recipes)
    if fault := contents.fault():
        raise MapFormatError(f"{path}: damaged: {fault}")
    return contents


def _recipes(
    path: str | Path, texts: Mapping[str, str], shapes: Mapping[str, tuple[str, list[int]]]
) -> Recipes:
    """Return how the arrays of a file were packed: each except the origin."""
    try:
        recipes = recipes_of(texts.get(_CODING, ""))
    except CodingError as error:
        raise MapFormatError(f"{path}: damaged: {error}") from error
    bytes_of = {name: shape for name, shape in shapes.items() if name != "origin"}
    for name, (dtype, shape) in bytes_of.items():
        if name not in recipes or name not in SCHEMA or dtype != "U8" or len(shape) != 1:
            raise MapFormatError(f"{path}: {name} is {dtype} {tuple(shape)}, must be packed")
    if lost := recipes.keys() - bytes_of.keys():
        raise MapFormatError(f"{path}: missing {', '.join(sorted(lost))}")
    if fault := fault_of_growth(recipes, sum(shape[0] for _, shape in bytes_of.values())):
        raise MapFormatError(f"{path}: damaged: {fault}")
    return recipes


def _unpack(path: str | Path, contents: Contents, recipes: Recipes) -> Contents:
    arrays, voxel = dict(contents.arrays), contents.cloud_voxel
    if fault := voxel_fault(voxel) or column_fault("origin", arrays["origin"]):
        raise MapFormatError(f"{path}: damaged: {fault}")
    stored: dict[str, Stored] = {}
    for name, recipe in recipes.items():
        dtype = _DTYPES[SCHEMA[name][0]]
        try:
            stored[name] = stored_array(arrays[name], recipe, dtype, arrays["origin"], voxel)
            arrays[name] = stored[name].array()
        except CodingError as error:
            raise MapFormatError(f"{path}: damaged: {name}: {error}") from error
        except MemoryError as error:
            raise MapFormatError(f"{path}: {name} does not fit into memory") from error
    return replace(contents, arrays=arrays, stored=stored)


def _hash(digest: hashlib.blake2b, part: Array) -> None:
    digest.update(part.data)


def _contents(path: str | Path, arrays: dict[str, Array], texts: Mapping[str, str]) -> Contents:
    try:
        voxel = float(texts["cloud_voxel"])
        metadata = dict(json.loads(texts["metadata"]).items())
    except (ValueError, AttributeError, RecursionError) as error:
        raise MapFormatError(f"{path}: damaged: unreadable text fields") from error
    return Contents(arrays, texts["descriptor"], texts["fingerprint"], voxel, metadata)


def _checked_version(path: str | Path, texts: Mapping[str, str]) -> int:
    version = texts.get(_VERSION, "")
    if not (version.isascii() and version.isdigit() and len(version) < 10):
        raise MapFormatError(f"{path}: not a segloc map")
    if int(version) > FORMAT_VERSION:
        raise MapFormatError(
            f"{path}: written by a newer segloc (map format {int(version)}, "
            f"this version reads up to {FORMAT_VERSION})"
        )
    return int(version)


def _header_digest(texts: Mapping[str, str], shapes: Mapping[str, tuple[str, list[int]]]) -> str:
    covered = {key: value for key, value in texts.items() if key != _CHECKSUM}
    encoded = json.dumps([covered, dict(shapes)], sort_keys=True).encode()
    return hashlib.blake2b(encoded, digest_size=16).hexdigest()


def shapes_fault(shapes: Mapping[str, tuple[str, list[int]]]) -> str | None:
    """Return the fault of a file's tensors by dtype and shape; None if valid."""
    missing = SCHEMA.keys() - OPTIONAL - shapes.keys()
    unknown = shapes.keys() - SCHEMA.keys()
    if missing or unknown:
        fault = "missing" if missing else "unknown"
        return f"{fault} {', '.join(sorted(missing or unknown))}"
    lengths: dict[str, int] = {}
    for name, (dtype, shape) in shapes.items():
        wanted_dtype, wanted, _ = SCHEMA[name]
        resolved = [lengths.get(d, d) if isinstance(d, str) else d for d in wanted]
        fits = len(shape) == len(wanted) and all(
            isinstance(w, str) or w == s for w, s in zip(resolved, shape, strict=True)
        )
        if dtype != wanted_dtype or not fits:
            text = ", ".join(str(d) for d in resolved)
            return f"{name} is {dtype} {tuple(shape)}, not {wanted_dtype} ({text})"
        for d, size in zip(wanted, shape, strict=True):
            if isinstance(d, str):
                lengths[d] = size
    if not 0 < lengths["D"] <= MAX_DIM:
        return f"vectors have {lengths['D']} numbers, must be 1 to {MAX_DIM}"
    return None
