"""Posed scans -> a map; several recordings in one frame -> one map, each a task of an executor."""

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
from ..frontend.reach import reach_fault
from ..frontend.segmentation import ClusterConfig, Segmentation, SegmentationConfig, Segmenter
from ..frontend.tilt import Lean, frame_lean, levelled
from ..system.files import folder_in
from ..system.processes import all_of
from ..types import Descriptors, Float64, Pose, Recording, Scanned, as_recording, stamp_at
from .compact import compacted
from .config import BuildConfig, MappingConfig, ViewConfig, checked_build_config
from .segment_map import SegmentMap

Progress = Callable[[int, int], None]


def build_map(
    scans: Scanned,
    config: BuildConfig | None = None,
    *,
    poses: ArrayLike | None = None,
    every_m: float | None = None,
    progress: Callable[[int, int], None] | None = None,
    adapt: bool = True,
) -> SegmentMap:
    """Build a map from scans with poses.

    Parameters
    ----------
    scans : Recording, or list of Scan or of (N, >=3) arrays
        With poses: they define the map frame, whose z axis must point up. Where it certainly does
        not, ``metadata["frame"]`` of the map says so; with ``config.mapping.level`` the poses are
        turned first, and ``metadata["T_map_odom"]`` says how.
    config : BuildConfig, optional
        Or a :class:`segloc.Config`, which is one; by default that of the default method.
    poses : (K, 4, 4) array, optional
        T_map_sensor of each scan; by default the scans' own ``T_odom_sensor``.
    every_m : float, optional
        Distance between views; overrides the configuration.
    progress : callable, optional
        Called with (views done, views in all).
    adapt : bool
        Whether :func:`adapted_to_view` may change the configuration.

    Raises
    ------
    DatasetError
        If there are no poses, or nothing that could be segmented, or the poses are to be levelled
        and nothing tells what is up.
    InvalidScan
        If a scan or a pose is none, or the numbers of both differ.
    ConfigError
        If ``config`` is none.
    """
    config = checked_build_config(config)
    sequence, frame = _framed(as_recording(scans, poses), config)
    path = _poses(sequence)
    config = adapted_to_view(config, [sequence]) if adapt else config
    descriptor = create(config.method, config.threads, config.weights)
    prior_map = empty_map(descriptor, config, path[0, :3, 3])
    for view in map_views(sequence, config, every_m=every_m, progress=progress):
        add_view(prior_map, view, descriptor.describe(view.scene.segments))
    if len(prior_map) == 0:
        raise DatasetError(f"{sequence.name}: {_nothing(sequence, config)}")
    prior_map.add_trajectory(path)
    used = config.model_copy(update={"threads": 0})  # the map does not depend on them
    prior_map.metadata["config"] = used.to_yaml()
    prior_map.metadata["sequence"] = sequence.name
    prior_map.metadata.update(frame)
    return compacted(prior_map, config.mapping.compact)


NARROW_VIEWS = tuple(ViewConfig(length_m=length, every_m=2.0) for length in (40, 16, 4))
NARROW_SEGMENTATION = SegmentationConfig(
    accumulated=ClusterConfig(voxel_size=0.1, tolerance=0.2, min_points=30),
    single=ClusterConfig(voxel_size=0.1, tolerance=0.3, min_points=10),
)
"""A narrow view holds few separate objects, and a turn of the sensor soon shows others. So segments
are finer, and views are closer together."""


def adapted_to_view(config: BuildConfig, recordings: Sequence[Recording]) -> BuildConfig:
    """Choose views and segmentation for sensors with a narrow field of view.

    The configuration is changed only if all recordings are of narrow sensors (less than
    ``NARROW_DEG``), and if ``mapping.views`` and ``segmentation`` have their default values. The
    map keeps it, so queries are segmented alike.
    """
    mapping, segmentation = config.mapping, config.segmentation
    default = mapping.views == MappingConfig().views and segmentation == SegmentationConfig()
    if not default or not is_narrow(recordings, config.local_cloud):
        return config
    mapping = mapping.model_copy(update={"views": NARROW_VIEWS})
    return config.model_copy(update={"mapping": mapping, "segmentation": NARROW_SEGMENTATION})


def _nothing(sequence: Recording, config: BuildConfig) -> str:
    """Why no segment was found."""
    middle = sequence.scan(len(sequence) // 2)
    why = reach_fault([middle], config.local_cloud.radius_m)
    found = f"no segment found in {len(sequence)} scans"
    return f"{found}: {why}" if why else f"{found}, the middle one of {len(middle)} points"


def _framed(sequence: Recording, config: BuildConfig) -> tuple[Recording, dict[str, str]]:
    """The recording in the map's frame, and what there is to say of that frame."""
    _poses(sequence)
    lean = frame_lean(sequence, config.local_cloud)
    if config.mapping.level:
        turned, T_map_odom = levelled(sequence, lean)
        angle = math.degrees(geometry.rotation_angle(T_map_odom))
        said = f"turned by {angle:.1f} degrees about its first pose, so that z is up"
        return turned, {"frame": said, "T_map_odom": json.dumps(T_map_odom.tolist())}
    if lean is None or not lean.noticed:
        return sequence, {}
    return sequence, {"frame": tilt_text(lean)}


def tilt_text(lean: Lean) -> str:
    """What a map's metadata say of a frame that is not level."""
    return f"tilted by {lean.tilt_deg:.1f} degrees: its z axis is not up"


@dataclass(frozen=True)
class View:
    """One local cloud of a map, segmented."""

    T_map_local: Pose
    stamp: float
    scene: Segmentation


def empty_map(descriptor: Descriptor, config: BuildConfig, origin: ArrayLike) -> SegmentMap:
    """A map of nothing yet, to be described by ``descriptor``; the origin is near its place."""
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
    """Add a view, whose segments have these descriptors, to a map of one session.

    Parameters
    ----------
    prior_map : SegmentMap
    view : View
    descriptors : Descriptors
    with_cloud : bool
        Whether the map is to hold the view's surface, which poses are verified against.
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
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[View]:
    """The views that :func:`build_map` describes, along the path; they depend on no descriptor.

    Raises
    ------
    DatasetError
        If there are no poses.
    """
    poses = _poses(sequence)
    accumulator, segmenter = Accumulator(config.local_cloud), Segmenter(config.segmentation)
    plan = _plan(poses, config, every_m)
    # Neighbouring views share most of their scans: each is read once.
    read = lru_cache(maxsize=max(len(scans) for _, scans in plan))(sequence.scan)
    for done, (index, scans) in enumerate(plan):
        cloud = accumulator.gather([read(i) for i in scans], index - scans.start)
        scene = segmenter.segment(cloud)
        yield View(geometry.levelled(poses[index]), _stamp(sequence, index), scene)
        if progress:
            progress(done + 1, len(plan))


def _stamp(sequence: Recording, index: int) -> float:
    """Seconds, or the scan's number where the recording has no times."""
    stamp = stamp_at(sequence, index)
    return float(sequence.indices[index]) if stamp is None else stamp


def _poses(sequence: Recording) -> Float64:
    poses = sequence.poses
    if poses is None or len(poses) == 0:
        raise DatasetError(
            f"{sequence.name}: building a map needs a pose for every scan, and none of "
            f"{len(sequence)} has one: T_odom_sensor of each Scan, poses=(K, 4, 4), or a file"
        )
    return poses


def _plan(poses: np.ndarray, config: BuildConfig, every_m: float | None) -> list[tuple[int, range]]:
    """The views of a map: (index of the reference scan, scans it gathers), along the path."""
    travelled = geometry.travelled(poses)
    plan: list[tuple[int, range]] = []
    for view in config.mapping.views:
        for index in geometry.stations(travelled, every_m or view.every_m):
            gap = config.local_cloud.max_gap_m
            scans = window(poses, int(index), view.length_m, centred=True, max_gap_m=gap)
            plan.append((int(index), scans))
    return sorted(plan, key=lambda item: item[0])


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
