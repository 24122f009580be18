"""What a run has done so far, one line of JSON each, so that the next goes on from there."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def entries(path: Path) -> list[dict[str, Any]]:
    """All that was kept in a file, in order."""
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()]


def keep(path: Path, entry: Mapping[str, Any]) -> None:
    """Add a line to a file, which need not exist."""
    with path.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(entry) + "\n")
