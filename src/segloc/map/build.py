"""Build maps from scans with poses: one recording, or several as tasks of an executor."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from .. import geometry
from ..descriptors import Descriptor, create
from ..errors import ConfigError, DatasetError
from ..frontend.field_of_view import is_narrow
from ..frontend.local_cloud import Accumulator, window
from ..frontend.segmentation import Segmentation, SegmentationConfig, Segmenter
from ..frontend.tilt import Tilt, frame_tilt, level_recording
from ..system.files import folder_in
from ..system.processes import all_of
from ..types import Descriptors, Float64, Pose, Recording, Scanned, as_recording, stamp_at
from .compact import compacted
from .config import (
    NARROW_SEGMENTATION,
    NARROW_VIEWS,
    BuildConfig,
    MappingConfig,
    checked_build_config,
)
from .segment_map import SegmentMap

Progress = Callable[[int, int], None]


def build_map(
    scans: Scanned,
    config: BuildConfig | None = None,
    *,
    poses: ArrayLike | None = None,
    every_m: float | None = None,
    progress: Progress | None = None,
    adapt: bool = True,
) -> SegmentMap:
    """Build a map as :func:`segloc.build_map` does, without comparing scans and poses.

    ``adapt`` lets :func:`adapt_to_view` change the configuration.
    """
    config = checked_build_config(config)
    sequence, frame = _frame(as_recording(scans, poses), config)
    path = _poses(sequence)
    config = adapt_to_view(config, [sequence]) if adapt else config
    descriptor = create(config.method, config.threads, config.weights)
    prior_map = empty_map(descriptor, config, path[0, :3, 3])
    for view in map_views(sequence, config, every_m=every_m, progress=progress):
        add_view(prior_map, view, descriptor.describe(view.scene.segments))
    if len(prior_map) == 0:
        raise DatasetError(f"{sequence.name}: {_nothing(sequence, config)}")
    prior_map.add_trajectory(path)
    used = config.model_copy(update={"threads": 0})  # maps do not depend on the threads
    prior_map.metadata["config"] = used.to_yaml()
    prior_map.metadata["sequence"] = sequence.name
    prior_map.metadata.update(frame)
    return compacted(prior_map, config.mapping.compact)


def adapt_to_view(config: BuildConfig, recordings: Sequence[Recording]) -> BuildConfig:
    """Choose views and segmentation for sensors with a narrow field of view.

    The configuration is changed only if all recordings are of narrow sensors (less than
    ``NARROW_DEG``) and ``mapping.views`` and ``segmentation`` have their default values. The map
    stores it, so that queries are segmented alike.
    """
    mapping, segmentation = config.mapping, config.segmentation
    default = mapping.views == MappingConfig().views and segmentation == SegmentationConfig()
    if not default or not is_narrow(recordings, config.local_cloud):
        return config
    mapping = mapping.model_copy(update={"views": NARROW_VIEWS})
    return config.model_copy(update={"mapping": mapping, "segmentation": NARROW_SEGMENTATION})


def _nothing(sequence: Recording, config: BuildConfig) -> str:
    """Return why no segment was found."""
    middle = sequence.scan(len(sequence) // 2)
    why = Accumulator(config.local_cloud).gather(middle).fault
    found = f"no segments in {len(sequence)} scans"
    return f"{found}: {why}" if why else f"{found}, {len(middle)} points in the middle one"


def _frame(sequence: Recording, config: BuildConfig) -> tuple[Recording, dict[str, str]]:
    """Return the recording in the map's frame, and metadata of that frame."""
    _poses(sequence)
    tilt = frame_tilt(sequence, config.local_cloud)
    if config.mapping.level:
        turned, T_map_odom = level_recording(sequence, tilt)
        angle = math.degrees(geometry.rotation_angle(T_map_odom))
        text = f"turned by {angle:.1f} degrees about its first pose, so that z is up"
        return turned, {"frame": text, "T_map_odom": json.dumps(T_map_odom.tolist())}
    if tilt is None or not tilt.is_significant:
        return sequence, {}
    return sequence, {"frame": tilt_text(tilt)}


def tilt_text(tilt: Tilt) -> str:
    """Return the metadata of a frame that is not level."""
    return f"tilted by {tilt.tilt_deg:.1f} degrees: its z axis is not up"


@dataclass(frozen=True)
class View:
    """Segmented local cloud of a map."""

    T_map_local: Pose
    stamp: float
    scene: Segmentation


def empty_map(descriptor: Descriptor, config: BuildConfig, origin: ArrayLike) -> SegmentMap:
    """Return an empty map for ``descriptor``; the origin should be near the place."""
    return SegmentMap.empty(
        descriptor.name,
        descriptor.fingerprint,
        descriptor.dim,
        origin,
        cloud_voxel=config.mapping.cloud_voxel,
    )


def add_view(
    prior_map: SegmentMap, view: View, descriptors: Descriptors, *, with_cloud: bool = True
) -> None:
    """Add a view with the descriptors of its segments to a map of one session.

    ``with_cloud`` also adds the view's surface, against which poses are verified.
    """
    segments = view.scene.segments
    surface = view.scene.surface if with_cloud else np.empty((0, 3))
    prior_map.add(
        descriptors,
        geometry.transform(view.T_map_local, segments.centroids),
        segments.sizes,
        session=0,
        stamp=view.stamp,
        cloud=geometry.transform(view.T_map_local, surface),
    )


def map_views(
    sequence: Recording,
    config: BuildConfig,
    *,
    every_m: float | None = None,
    progress: Progress | None = None,
) -> Iterator[View]:
    """Yield the views that :func:`build_map` describes, along the trajectory.

    Raises
    ------
    DatasetError
        If there are no poses.
    """
    poses = _poses(sequence)
    accumulator, segmenter = Accumulator(config.local_cloud), Segmenter(config.segmentation)
    plan = _plan(poses, config, every_m)
    # Neighbouring views share most of their scans, so each scan is read once.
    read = lru_cache(maxsize=max(len(scans) for _, scans in plan))(sequence.scan)
    for done, (index, scans) in enumerate(plan):
        cloud = accumulator.gather([read(i) for i in scans], index - scans.start)
        scene = segmenter.segment(cloud)
        yield View(geometry.levelled(poses[index]), _stamp(sequence, index), scene)
        if progress:
            progress(done + 1, len(plan))


def _stamp(sequence: Recording, index: int) -> float:
    """Return the scan's stamp [s], or its number if the recording has no stamps."""
    stamp = stamp_at(sequence, index)
    return float(sequence.indices[index]) if stamp is None else stamp


def _poses(sequence: Recording) -> Float64:
    poses = sequence.poses
    if poses is None or len(poses) == 0:
        raise DatasetError(
            f"{sequence.name}: a map needs a pose for every scan, and none of the {len(sequence)} "
            "has one: set T_odom_sensor of each Scan, or pass poses=(K, 4, 4) or a file"
        )
    return poses


def _plan(poses: np.ndarray, config: BuildConfig, every_m: float | None) -> list[tuple[int, range]]:
    """Return the views of a map (index of the reference scan, range of scans)."""
    travelled = geometry.distance_travelled(poses)
    plan: list[tuple[int, range]] = []
    for view in config.mapping.views:
        for index in geometry.stations(travelled, every_m or view.every_m):
            gap = config.local_cloud.max_gap_m
            scans = window(poses, int(index), view.length_m, centred=True, max_gap_m=gap)
            plan.append((int(index), scans))
    return sorted(plan, key=lambda item: item[0])


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
    """Build a map of several sessions whose poses share a frame.

    The result does not depend on the executor or the number of its workers.

    Parameters
    ----------
    recordings : sequence of Recording
        Session 0 is the first, and so on. For processes and clusters they must be picklable and
        their files readable by the workers.
    config : BuildConfig
        Also a :class:`segloc.Config`.
    progress : callable, optional
        Called with (sessions done, total).
    every_m : float, optional
        Distance between views; overrides the configuration.
    views : callable, optional
        Called with (views done, total) of each session mapped in this process.
    executor : Executor, optional
        Maps the sessions, one thread each; by default in this process.
    folder : path, optional
        Shared with all workers of the executor, for temporary maps of single sessions. By default
        the system's temporary folder.

    Raises
    ------
    ConfigError
        If there are no recordings.
    DatasetError
        If a recording has no poses or no segments.
    SeglocError
        If a file cannot be written, or a process was killed repeatedly.
    """
    if not recordings:
        raise ConfigError("no recordings to map")
    with folder_in(folder if executor else None, ".segloc-parts-") as parts:
        config = adapt_to_view(config, recordings)
        own = config.model_copy(update={"threads": 1}) if executor else config
        mapped = partial(_map_one, own, every_m, None if executor else views)
        tasks = [
            (recording, parts / f"{k}.segmap" if executor else None)
            for k, recording in enumerate(recordings)
        ]
        found = all_of(mapped, tasks, executor, progress)
        maps = [m if isinstance(m, SegmentMap) else SegmentMap.load(m) for m in found]
    return maps[0] if len(maps) == 1 else compacted(_merge(maps), config.mapping.compact)


def _map_one(
    config: BuildConfig,
    every_m: float | None,
    views: Progress | None,
    task: tuple[Recording, Path | None],
) -> SegmentMap | Path:
    """Map one recording in any process; return the map, or the file it is written to."""
    recording, out = task
    prior_map = build_map(recording, config, every_m=every_m, progress=views, adapt=False)
    if out is None:
        return prior_map
    prior_map.save(out)
    return out


def _merge(maps: Sequence[SegmentMap]) -> SegmentMap:
    """Merge pairwise in halves; one by one, each merge would cost as much as all before."""
    if len(maps) == 1:
        return maps[0]
    half = (len(maps) + 1) // 2
    return _merge(maps[:half]).merge(_merge(maps[half:]))
