"""A recording localized part by part, by whatever executes tasks: processes, or a cluster."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..config import Config
from ..localization import Localization
from ..localizer import Localizer
from ..map.segment_map import SegmentMap
from ..prior import Prior
from ..system.processes import as_finished
from ..tiles import TiledMap, holds_tiles
from ..types import Int64, Recording
from .run import Priors, each_prior, localize_sequence

QUERIES = 16
"""Of a part: enough that windows of neighbouring queries share their work."""


@dataclass(frozen=True)
class Place:
    """Where queries are localized, in few bytes: each process opens it once a run.

    Attributes
    ----------
    where : str
        A map file, or the folder or URL of tiles.
    config : Config
    run : str
        Another one for every run: maps may be replaced in between.
    """

    where: str
    config: Config
    run: str


@dataclass(frozen=True)
class Part:
    """Some queries of a recording: a task that can be done again, and gives the same."""

    place: Place
    recording: Recording
    positions: Int64
    near: tuple[Prior | None, ...]


@lru_cache(maxsize=2)
def _opened(place: Place) -> Localizer:
    tiled = holds_tiles(place.where)
    prior_map = TiledMap(place.where) if tiled else SegmentMap.load(place.where)
    return Localizer(prior_map, place.config)


def _localized(part: Part) -> list[Localization]:
    localizer = _opened(part.place)
    return localize_sequence(localizer, part.recording, part.positions, near=part.near)


def localize_parts(
    where: str,
    config: Config,
    recording: Recording,
    positions: Int64,
    executor: Executor,
    progress: Callable[[int, int], None] | None = None,
    near: Priors = None,
) -> list[Localization]:
    """Localize the scans at some positions of a recording, whoever does it.

    Poses, confidences and reasons are those of :func:`segloc.batch.run.localize_sequence`, to the
    last bit; each process uses one thread.

    Parameters
    ----------
    where : str
        A map file, or the folder or URL of tiles, that every process can open.
    config : Config
    recording : Recording
        Can be pickled; its files are read where the tasks are done.
    positions : (Q,) int64
    executor : Executor
        Of processes, threads, or a cluster.

    Raises
    ------
    SeglocError
        What localizing raises; and if a process was ended and its tasks are not done again.
    """
    place = Place(where, config.model_copy(update={"threads": 1}), uuid.uuid4().hex)
    chunks = np.array_split(positions, max(1, -(-len(positions) // QUERIES)))
    priors, parts, done = each_prior(near, len(positions)), [], 0
    for chunk in chunks:
        own = tuple(priors[done : done + len(chunk)])
        parts.append(Part(place, recording, chunk, own))
        done += len(chunk)
    found: dict[int, list[Localization]] = {}
    for number, results in as_finished(_localized, parts, executor):
        found[number] = results
        if progress:
            progress(sum(map(len, found.values())), len(positions))
    return [result for number in sorted(found) for result in found[number]]
