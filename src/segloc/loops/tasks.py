"""Tasks of an alignment (recordings, parts, pairs of submaps), and their shared store."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..config import Config
from ..errors import DatasetError
from ..frontend.segmentation import Segmentation
from ..localizer import Localizer
from ..map.build import empty_map
from ..map.segment_map import SegmentMap
from ..proposals.first_sight import FirstSightConfig
from ..system.files import folder_in, write_bytes
from ..system.processes import all_of
from ..types import Descriptors, Float64, Recording, Segments
from .config import AlignConfig
from .growing_map import PartsVote, blocks_of, searchable_parts, thin
from .loops import (
    Chain,
    Loop,
    Pair,
    SubmapRegistration,
    best_per_pair,
    loop_in_part,
    query_of,
)
from .submaps import Progress, Reader, Session, Submap

Stage = Callable[[str], AbstractContextManager[Progress]]
Task = TypeVar("Task")
Result = TypeVar("Result")

_VOTERS, _PAIRS = 32, 64
"""Number of submaps, and of pairs of them, per task."""
_CACHED_SUBMAPS, _CACHED_MAPS = 256, 2


@dataclass(frozen=True)
class Workspace:
    """Store shared by all tasks, settings and executor of a run; None for this process."""

    store: SubmapStore
    config: Config
    settings: AlignConfig
    executor: Executor | None = None

    def all_of(
        self,
        work: Callable[[Workspace, Task], Result],
        tasks: Sequence[Task],
        progress: Progress | None = None,
    ) -> list[Result]:
        """Return the results of tasks, each of which has the workspace without the executor."""
        return all_of(partial(work, replace(self, executor=None)), tasks, self.executor, progress)

    def registration(self) -> SubmapRegistration:
        """Return the registration of stored submaps."""
        return SubmapRegistration(self.store, self.settings, self.config.threads)


@contextmanager
def open_workspace(
    config: Config, settings: AlignConfig, executor: Executor | None, folder: str | Path | None
) -> Iterator[Workspace]:
    """Open a workspace in a folder, removed at the end; workers have one thread each."""
    if executor is not None:
        config = config.model_copy(update={"threads": 1})
    with folder_in(folder, ".segloc-align-") as made:
        try:
            yield Workspace(SubmapStore(made), config, settings, executor)
        finally:
            forget()


# --- recordings -> submaps and parts --------------------------------------------------------------


@dataclass(frozen=True)
class Described:
    """Session to describe, with the numbers of its first submap and part."""

    number: int
    recording: Recording
    session: Session
    first_submap: int
    first_part: int


def describe(workspace: Workspace, task: Described, progress: Progress | None = None) -> None:
    """Store a session's submaps and parts.

    Raises
    ------
    DatasetError
        If a scan cannot be read, or there are no segments; names the session.
    """
    store, config, settings = workspace.store, workspace.config, workspace.settings
    session, segments = task.session, 0
    try:
        reader = Reader(task.recording, session.poses, config)
        for k, nodes in enumerate(session.parts(settings.part_m), task.first_part):
            part = empty_map(reader.descriptor, config, session.poses[0, :3, 3])
            for node in nodes.tolist():
                submap = reader.submap(int(session.anchors[node]), settings, part)
                store.put(task.first_submap + node, submap)
                if progress:
                    progress(node + 1, len(session.anchors))
            store.put_map(f"part_{k}", part)
            store.put_map(f"thin_{k}", thin(part))
            segments += len(part)
        if not segments:
            raise DatasetError(f"{session.name}: no segments in {len(task.recording)} scans")
    except DatasetError as error:  # names of sessions may repeat, so give the number, too
        raise DatasetError(f"session {task.number}: {error}") from error


def describe_all(workspace: Workspace, tasks: Sequence[Described], stage: Stage) -> None:
    """Store all sessions."""
    if workspace.executor is not None:
        with stage("Describing sessions") as update:
            workspace.all_of(describe, tasks, update)
        return
    for task in tasks:
        with stage(f"Describing session {task.number + 1} of {len(tasks)}") as update:
            describe(workspace, task, update)


# --- submaps -> loops -----------------------------------------------------------------------------


def find_loops(workspace: Workspace, chain: Chain, progress: Progress | None = None) -> list[Loop]:
    """Localize every submap in the earlier parts with most of its votes.

    Returns
    -------
    list of Loop
        Localized and refined loops, accepted or not, at most one per pair of submaps.
    """
    tasks = [
        (k, chain.parts[k].tolist(), chain.odometry[chain.parts[k]], sources)
        for k, sources in _submaps_to_search(workspace, chain).items()
    ]
    found = workspace.all_of(_loops, tasks, progress)
    return best_per_pair([loop for loops in found for loop in loops])


def _submaps_to_search(workspace: Workspace, chain: Chain) -> dict[int, list[int]]:
    """Return the submaps to localize in each part."""
    settings = workspace.settings
    found: dict[int, list[int]] = {k: [] for k in range(len(chain.parts))}
    voters: dict[range, list[int]] = {}
    for source, known in enumerate(searchable_parts(chain, settings.min_travel_m).tolist()):
        for block in blocks_of(known) if known > settings.searched_parts else ():
            voters.setdefault(block, []).append(source)
        for part in range(known) if known <= settings.searched_parts else ():
            found[part].append(source)
    tasks = [
        (block, sources[k : k + _VOTERS * len(block)])  # enough to amortise building its map
        for block, sources in sorted(voters.items(), key=lambda item: (item[0].start, item[0].stop))
        for k in range(0, len(sources), _VOTERS * len(block))
    ]
    ballots: dict[int, list[tuple[int, int]]] = {}
    for votes in workspace.all_of(_votes, tasks):
        for source, part, inliers in votes:
            ballots.setdefault(source, []).append((-inliers, part))
    for source, ballot in ballots.items():
        for _, part in sorted(ballot)[: settings.searched_parts]:
            found[part].append(source)
    return {k: sorted(sources) for k, sources in found.items() if sources}


def _votes(workspace: Workspace, task: tuple[range, list[int]]) -> list[tuple[int, int, int]]:
    """Return submap, part and votes of submaps that vote in a block."""
    block, sources = task
    parts = [workspace.store.map(f"thin_{k}") for k in block]
    vote = PartsVote(parts, workspace.config, workspace.settings)
    return [
        (source, block.start + part, inliers)
        for source in sources
        for part, inliers in vote.of(workspace.store[source]).items()
    ]


def _loops(workspace: Workspace, task: tuple[int, list[int], Float64, list[int]]) -> list[Loop]:
    """Localize submaps in the map of a part: its number, submaps and their poses, the sources."""
    part, nodes, poses, sources = task
    prior_map = workspace.store.map(f"part_{part}")
    if not len(prior_map):
        return []
    # Of the loops of a pair the one is kept on which most segments agree.
    by_segments = FirstSightConfig(enabled=False)
    config = workspace.config.model_copy(update={"first_sight": by_segments})
    localizer, register = Localizer(prior_map, config), workspace.registration()
    found = [
        loop_in_part(localizer, query_of(workspace.store[k]), k, nodes, poses, register)
        for k in sources
    ]
    return [each[0] for each in found if each is not None]


# --- neighbours -> dense loops --------------------------------------------------------------------


def tie(
    workspace: Workspace, pairs: Sequence[Pair], progress: Progress | None = None
) -> list[Loop]:
    """Align pairs of submaps; skip those where ICP fails."""
    tasks = [pairs[k : k + _PAIRS] for k in range(0, len(pairs), _PAIRS)]
    found = workspace.all_of(_tie, tasks, progress)
    return [loop for loops in found for loop in loops]


def _tie(workspace: Workspace, pairs: Sequence[Pair]) -> list[Loop]:
    register = workspace.registration()
    loops = [register.loop(*pair, "dense") for pair in pairs]
    return [loop for loop in loops if loop is not None]


@dataclass(frozen=True)
class SubmapStore:
    """Submaps by number and maps by name, in a folder shared by all tasks.

    Storage is lossless. Each process caches recent entries until :func:`forget`.

    Raises
    ------
    DatasetError
        If an entry is missing or damaged; names the file.
    SeglocError
        If a file cannot be written.
    """

    folder: Path

    def put(self, number: int, submap: Submap) -> None:
        """Store a submap."""
        file = BytesIO()
        np.savez(file, allow_pickle=False, **_arrays_of(submap))
        write_bytes(self._submap(number), file.getbuffer(), sweep=False)

    def __getitem__(self, number: int, /) -> Submap:
        return _read_submap(self._submap(number))

    def put_map(self, name: str, prior_map: SegmentMap) -> None:
        """Store a map."""
        prior_map.save(self._map(name))

    def map(self, name: str) -> SegmentMap:
        """Load a stored map."""
        return _read_map(self._map(name))

    def _submap(self, number: int) -> Path:
        return self.folder / f"submap_{number}.npz"

    def _map(self, name: str) -> Path:
        return self.folder / f"{name}.segmap"


def _arrays_of(submap: Submap) -> dict[str, Any]:
    segments, described = submap.scene.segments, submap.descriptors
    arrays: dict[str, Any] = {
        "T_odom_local": submap.T_odom_local,
        "centroids": segments.centroids,
        "heights": segments.heights,
        "offsets": segments.offsets,
        "points": segments.points,
        "above_ground": submap.scene.structure,
        "ground": submap.scene.ground,
        "vectors": described.vectors,
        "structure": submap.structure,
        "surface": submap.surface,
    }
    return arrays if described.quality is None else arrays | {"quality": described.quality}


@lru_cache(maxsize=_CACHED_SUBMAPS)
def _read_submap(path: Path) -> Submap:
    try:
        with np.load(path, allow_pickle=False) as file:
            a = dict(file)
            segments = Segments(a["points"], a["offsets"], a["centroids"], a["heights"])
            scene = Segmentation(segments, a["above_ground"], a["ground"])
            described = Descriptors(a["vectors"], a.get("quality"))
            return Submap(a["T_odom_local"], scene, described, a["structure"], a["surface"])
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise DatasetError(f"{path}: cannot be read: {error}") from error


@lru_cache(maxsize=_CACHED_MAPS)
def _read_map(path: Path) -> SegmentMap:
    return SegmentMap.load(path)


def forget() -> None:
    """Clear the caches of this process."""
    _read_submap.cache_clear()
    _read_map.cache_clear()
