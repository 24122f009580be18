"""Recordings that share a frame -> one map; each is a task that anyone may do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ..errors import ConfigError
from ..system.files import folder_in
from ..system.processes import all_of
from ..types import Recording
from .build import adapted_to_view, build_map
from .compact import compacted
from .config import BuildConfig
from .segment_map import SegmentMap

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class _Task:
    """A recording to be mapped; ``out`` is the file of its map, None: it is handed back."""

    recording: Recording
    config: BuildConfig
    every_m: float | None
    out: Path | None


def build_merged_map(
    recordings: Sequence[Recording],
    config: BuildConfig,
    progress: Progress | None = None,
    *,
    every_m: float | None = None,
    views: Progress | None = None,
    executor: Executor | None = None,
    folder: str | Path | None = None,
) -> SegmentMap:
    """A map of several sessions whose poses share a frame.

    The map depends neither on the executor nor on the number of its workers.

    Parameters
    ----------
    recordings : sequence of Recording
        The segments of the first are marked as session 0, and so on. For processes and clusters
        they can be pickled, and their files are read where the tasks are done.
    config : BuildConfig
        Or a :class:`segloc.Config`, which is one.
    progress : callable, optional
        Called with (sessions done, sessions in all).
    every_m : float, optional
        Distance between views; overrides the configuration.
    views : callable, optional
        Called with (views done, views in all) of each session that this process maps.
    executor : Executor, optional
        Maps the sessions, each with one thread; by default this process does.
    folder : path, optional
        That all workers of the executor see: maps of single sessions lie in a folder in it until
        they are merged. By default the system's folder for temporary files.

    Raises
    ------
    ConfigError
        If there is no recording.
    DatasetError
        If a recording has no poses, or nothing that could be segmented.
    SeglocError
        If a file cannot be written, or a process was ended again and again.
    """
    if not recordings:
        raise ConfigError("there is no session to map")
    with folder_in(folder if executor else None, ".segloc-parts-") as parts:
        config = adapted_to_view(config, recordings)
        own = config.model_copy(update={"threads": 1}) if executor else config
        files = [parts / f"{k}.segmap" if executor else None for k in range(len(recordings))]
        tasks = [
            _Task(recording, own, every_m, file)
            for recording, file in zip(recordings, files, strict=True)
        ]
        mapped = _mapped if executor else partial(_mapped, views=views)
        found = all_of(mapped, tasks, executor, progress)
        maps = [m if isinstance(m, SegmentMap) else SegmentMap.load(m) for m in found]
    return maps[0] if len(maps) == 1 else compacted(_merged(maps), config.mapping.compact)


def _mapped(task: _Task, views: Progress | None = None) -> SegmentMap | Path:
    """The map of one recording, or the file that holds it, in whatever process."""
    prior_map = build_map(
        task.recording, task.config, every_m=task.every_m, progress=views, adapt=False
    )
    if task.out is None:
        return prior_map
    prior_map.save(task.out)
    return task.out


def _merged(maps: Sequence[SegmentMap]) -> SegmentMap:
    """Merged by halves: one after another, each would cost as much as all before it."""
    if len(maps) == 1:
        return maps[0]
    half = (len(maps) + 1) // 2
    return _merged(maps[:half]).merge(_merged(maps[half:]))
