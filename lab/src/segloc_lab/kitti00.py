"""KITTI odometry 00: which part of the drive is mapped, and which is localized in it.

A folder DATA holds ``keyframes/`` (thinned) and ``scans/`` (full, of the first 827 m), and their
T_world_sensor in ``keyframes.tum`` and ``scans.tum``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from segloc.errors import DatasetError
from segloc.tools.batch import query_positions
from segloc.tools.datasets import NO_POSES, Recording, Sequence, open_sequence
from segloc.types import Float64

from .evaluation.scenario import MAX_GAP_M, QuerySet

FIRST_HALF, SECOND_HALF = "100:947", "948:1820"
LATER_PASSES = "619:654,988:1003,1361:1600"
"""Of the places that the full scans show."""

EVERY_M = 10.0


@dataclass(frozen=True)
class Protocol:
    """What is localized in which map.

    Attributes
    ----------
    mapped, map_name : str
        Keyframes, and what ``kitti00.sh`` calls their map.
    folder : str
        Of the queries.
    select : str or None
        The scans among which queries are chosen; all of them by default.
    accumulated : bool
        Whether a query is the cloud of the path behind it, not one scan.
    every_m : float or None
        Metres between queries; every scan by default.
    """

    mapped: str
    map_name: str
    folder: str
    select: str | None
    accumulated: bool
    every_m: float | None


PROTOCOLS = {
    "accumulated": Protocol(FIRST_HALF, "first", "keyframes", SECOND_HALF, True, EVERY_M),
    "sparse": Protocol(FIRST_HALF, "first", "keyframes", SECOND_HALF, False, EVERY_M),
    "single": Protocol(LATER_PASSES, "later", "scans", None, False, None),
}


def keyframes(data: Path, select: str | None = None, posed: bool = True) -> Sequence:
    """The thinned scans of the whole drive, or some of them, with or without their poses."""
    return open_sequence(data / "keyframes", "keyframes.tum" if posed else NO_POSES, select)


def scans(data: Path, posed: bool = True) -> Sequence:
    """The full scans of the first 827 m."""
    return open_sequence(data / "scans", "scans.tum" if posed else NO_POSES)


def poses_of(recording: Recording) -> Float64:
    """The poses of a recording."""
    if recording.poses is None:
        raise DatasetError(f"{recording.name}: no poses")
    return recording.poses


def mapped(data: Path, protocol: str) -> Sequence:
    """The recording that a protocol's map is made of."""
    return keyframes(data, PROTOCOLS[protocol].mapped)


def query_set(data: Path, protocol: str, step: int = 1) -> QuerySet:
    """Every ``step``-th query of a protocol."""
    p = PROTOCOLS[protocol]
    posed = keyframes(data, p.select) if p.folder == "keyframes" else scans(data)
    truths = poses_of(posed)
    recording = posed
    if not p.accumulated:
        single = p.folder == "keyframes"
        recording = keyframes(data, p.select, False) if single else scans(data, False)
    positions = np.arange(len(truths), dtype=np.int64)
    if p.every_m is not None:
        positions = query_positions(truths, p.every_m, MAX_GAP_M)
    positions = positions[::step]
    return QuerySet(recording, positions, truths[positions])
