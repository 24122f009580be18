"""Files that are there whole or not at all."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from ..errors import DatasetError


def write_atomically(path: Path, data: bytes) -> None:
    """Write to a hidden temporary file in the same folder, then rename it to ``path``.

    Raises
    ------
    DatasetError
        If the file cannot be written; ``path`` is then what it was before.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)  # noqa: PTH105
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise DatasetError(f"{path}: cannot write: {error.strerror or error}") from error
