"""A folder of results, as ``segloc localize --out`` leaves it, for a viewer."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ..errors import SeglocError
from ..types import Pose
from .seen import Seen, unpacked

Outcome = Literal["found", "refused", "false"]
DEBUG = "debug"
"""The folder in it of what ``--debug`` keeps, one file a query."""


@dataclass(frozen=True)
class Shown:
    """One query of a folder of results.

    Attributes
    ----------
    index : int
    outcome : "found", "refused" or "false"
        "false" only where the truth is known.
    said : str
        The pose or the reason, in one line.
    T_map_sensor : (4, 4) float64 or None
        Where it was localized.
    seen : Seen or None
        Stage by stage, where it was kept.
    """

    index: int
    outcome: Outcome
    said: str
    T_map_sensor: Pose | None
    seen: Seen | None


def read_results(folder: Path) -> list[Shown]:
    """All queries of a folder of results.

    Raises
    ------
    SeglocError
        If it is no such folder, or a file in it is damaged.
    """
    file = folder / "localizations.jsonl"
    try:
        lines = file.read_text("utf-8").splitlines()
    except OSError as error:
        raise SeglocError(f"{folder}: no results of `segloc localize --out` ({error})") from error
    return [_shown(folder, file, number, line) for number, line in enumerate(lines, 1)]


def _shown(folder: Path, file: Path, number: int, line: str) -> Shown:
    try:
        record = json.loads(line)
        index, confidence = int(record["index"]), float(record["confidence"])
        pose = record["T_map_sensor"]
        T = None if pose is None else np.array(pose, dtype=np.float64).reshape(4, 4)
        message, correct = str(record["message"]), record.get("correct")
    except (ValueError, KeyError, TypeError) as error:
        raise SeglocError(f"{file}: line {number}: damaged ({error})") from error
    outcome: Outcome = "refused" if T is None else "false" if correct is False else "found"
    kept = folder / DEBUG / f"{index}.npz"
    return Shown(
        index,
        outcome,
        f"{message or 'localized'} (confidence {confidence:.2f})",
        T,
        unpacked(kept.read_bytes(), str(kept)) if kept.is_file() else None,
    )
