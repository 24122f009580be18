"""Finished parts of a study on disk: each a folder with its settings and checksums."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from segloc._native import __version__
from segloc.errors import SeglocError

DATA, _ENTRY = "data", "entry.json"


def save_json(value: Any, path: Path) -> None:
    """Write a value that JSON can hold."""
    path.write_text(json.dumps(value, allow_nan=False), "utf-8")


def load_json(path: Path) -> Any:
    """What :func:`save_json` wrote."""
    return json.loads(path.read_text("utf-8"))


def save_arrays(arrays: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Write arrays by name."""
    with path.open("wb") as stream:
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]


def load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """What :func:`save_arrays` wrote."""
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        return dict(file)


def store(folder: Path, entry: dict[str, object], save: Callable[[Path], object]) -> None:
    """Write an entry: the whole of it, or nothing.

    Raises
    ------
    SeglocError
        If the folder cannot be written.
    """
    temporary = folder.with_name(f".{folder.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        temporary.mkdir(parents=True)
        save(temporary / DATA)
        entry = {**entry, "sha256": _digests(temporary / DATA)}
        (temporary / _ENTRY).write_text(json.dumps(entry, indent=1, default=str) + "\n", "utf-8")
        if folder.exists():
            shutil.rmtree(folder)
        temporary.replace(folder)
    except OSError as error:
        where = error.filename or folder
        raise SeglocError(f"{where}: cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def check(folder: Path) -> None:
    """Raise ValueError, KeyError or OSError if the files of an entry are not as they were."""
    entry = load_json(folder / _ENTRY)
    if entry["sha256"] != _digests(folder / DATA):
        raise ValueError("its files do not match their checksums")


def _digests(path: Path) -> dict[str, str]:
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    return {str(file.relative_to(path.parent)): _file_digest(file) for file in files}


def _file_digest(path: Path) -> str:
    value = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(1 << 20):
            value.update(block)
    return value.hexdigest()


def digest(settings: Mapping[str, object]) -> str:
    """Of settings and of this version of segloc."""
    text = json.dumps({"segloc": __version__, **settings}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
