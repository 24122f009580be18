"""Weights files: named tensors with settings, a card and a hash, as one safetensors file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..errors import INSTALL_LAB, DatasetError, WeightsError
from ..system import tensor_file
from ..system.budget import check_bytes
from ..system.files import replacing
from ..system.tensor_file import TensorFile, TensorFileError

_VERSION = "2"
_LABORATORY = "segloc_lab"
"""Distribution with the weights of the methods for comparison."""
_OF_CONTENT = (TypeError, ValueError, OverflowError, AttributeError, RecursionError, LookupError)
"""Errors of NumPy and the networks for invalid contents; TypeError: an unknown dtype."""


FIELDS = {
    "format": "`segloc` and the kind",
    "version": f"`{_VERSION}`",
    "settings": "JSON object of text to text: all that determines the result beside the tensors",
    "card": "JSON object: data, command, figures, licence",
    "sha256": "hash of settings and tensors, as hexadecimal digits",
}
"""Text fields of ``__metadata__`` and their meaning."""


@dataclass(frozen=True)
class WeightFile:
    """Contents of a weights file.

    Attributes
    ----------
    tensors : mapping of str to arrays
        Float32, except those with a dtype given to the reader.
    settings : mapping of str to str
        Parameters of the network beside the tensors.
    card : dict
        Origin of the weights: data, command, figures, licence.
    sha256 : str
        Hash of tensors and settings.
    """

    tensors: dict[str, NDArray[Any]]
    settings: dict[str, str]
    card: dict[str, Any]
    sha256: str


def write_weights(
    path: Path,
    kind: str,
    tensors: Mapping[str, NDArray[Any]],
    settings: Mapping[str, str],
    card: Mapping[str, Any],
) -> None:
    """Write a weights file of one kind of network.

    Raises
    ------
    SeglocError
        If it cannot be written.
    """
    metadata = {
        "format": f"segloc {kind}",
        "version": _VERSION,
        "settings": json.dumps(dict(settings), sort_keys=True),
        "card": json.dumps(dict(card), sort_keys=True),
        "sha256": digest_of(tensors, settings),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as stream:
        tensor_file.write_tensors(stream, tensors, metadata)


def read_weights(
    path: Path, kind: str, dtypes: Mapping[str, DTypeLike] | None = None
) -> WeightFile:
    """Read and check a weights file.

    ``dtypes`` maps tensors that are not float32 to their dtype.

    Raises
    ------
    WeightsError
        If the file is missing, truncated, of another kind or version, does not match its hash, or
        if a tensor is of the wrong dtype or not finite.
    """
    metadata, tensors = _read(path)
    if metadata.get("format") != f"segloc {kind}" or metadata.get("version") != _VERSION:
        of = f"{metadata.get('format', '')} of version {metadata.get('version', '?')}"
        held = of if of.startswith("segloc ") else "something else"
        raise WeightsError(
            f"{path}: not a {kind} of format version {_VERSION}, but {held:.60}: pass the weights "
            "of the method, or its --method"
        )
    for name, tensor in tensors.items():
        expected = np.dtype((dtypes or {}).get(name, np.float32))
        if tensor.dtype != expected:
            raise WeightsError(f"{path}: tensor '{name}' is {tensor.dtype}, expected {expected}")
        if not np.isfinite(tensor).all():
            raise WeightsError(f"{path}: tensor '{name}' has values that are not finite")
    try:
        settings, card = json.loads(metadata["settings"]), json.loads(metadata["card"])
        texts = isinstance(settings, dict) and all(isinstance(v, str) for v in settings.values())
    except (KeyError, ValueError, RecursionError) as error:
        raise WeightsError(f"{path}: the metadata is damaged ({error})") from error
    if not texts or not isinstance(card, dict):
        raise WeightsError(f"{path}: the metadata is damaged")
    digest = digest_of(tensors, settings)
    if digest != metadata.get("sha256"):
        raise WeightsError(f"{path}: the tensors do not match their hash")
    return WeightFile(tensors, settings, card, digest)


def shipped_weights(file: str) -> Path:
    """Return the path of a weights file of segloc or segloc-lab.

    Raises
    ------
    WeightsError
        If neither contains it.
    """
    folders = [Path(__file__).resolve().parent.parent]
    if spec := find_spec(_LABORATORY):
        folders += [Path(folder) for folder in spec.submodule_search_locations or ()]
    for folder in folders:
        path = folder / "weights" / file
        if path.is_file():
            return path
    raise WeightsError(f"{file} belongs to segloc-lab: {INSTALL_LAB}")


def _read(path: Path) -> tuple[dict[str, str], dict[str, NDArray[Any]]]:
    with open_weights(path) as file:
        return file.metadata, {name: file.read(name) for name in sorted(file.tensors)}


@contextmanager
def open_weights(path: Path) -> Iterator[TensorFile]:
    """Open a safetensors file for reading, without mapping it, since it may shrink meanwhile.

    Raises
    ------
    WeightsError
        If it is missing or damaged, now or on reading a tensor.
    """
    if path.is_dir():
        raise WeightsError(f"{path}: is a directory")
    if path.exists() and not path.is_file():  # a pipe may never end
        raise WeightsError(f"{path}: not a regular file")
    try:
        check_bytes(path.stat().st_size, "a file")
        with tensor_file.open_tensor_file(path) as file:
            yield file
    except FileNotFoundError as error:
        raise WeightsError(f"{path}: no such file") from error
    except MemoryError as error:
        raise WeightsError(f"{path}: not enough memory to read it") from error
    except (OSError, TensorFileError, DatasetError, *_OF_CONTENT) as error:
        raise WeightsError(f"{path}: cannot be read as weights ({error})") from error


@contextmanager
def faults_of_weights(path: Path) -> Iterator[None]:
    """Convert errors of invalid settings and tensors.

    Raises
    ------
    WeightsError
        Names the file.
    """
    try:
        yield
    except KeyError as error:
        raise WeightsError(f"{path}: {error} is missing") from error
    except MemoryError as error:
        raise WeightsError(f"{path}: not enough memory for such a network") from error
    except _OF_CONTENT as error:
        raise WeightsError(f"{path}: {error}") from error


def digest_of(tensors: Mapping[str, NDArray[Any]], settings: Mapping[str, str]) -> str:
    """Return the SHA-256 of tensors and settings, independent of their order."""
    digest = hashlib.sha256(json.dumps(dict(settings), sort_keys=True).encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        tensor = np.ascontiguousarray(tensor, dtype=tensor.dtype.newbyteorder("<"))
        digest.update(f"{name} {tensor.shape} ".encode())
        digest.update(tensor.tobytes())
    return digest.hexdigest()
