"""Recordings and simulated worlds -> a dataset folder."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from segloc.datasets.signature import is_push_broom
from segloc.frontend.segmentation import SegmentationConfig, Segmenter
from segloc.system.processes import as_finished, single_threaded_pool
from segloc.types import Recording

from .extract import ExtractConfig, extract_session
from .session_registration import Registration
from .shards import Session, finished, options_of, read_array, write_shard
from .worlds import WorldSpec, simulated_drive, sweeps

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Posed:
    """A posed recording as a session of a place."""

    session: Session
    recording: Recording


@dataclass(frozen=True)
class _Task:
    """One recording's shard, to be written by whatever process."""

    folder: Path
    item: Posed
    before: tuple[Session, ...]
    config: ExtractConfig
    segmentation: SegmentationConfig
    register: bool


def collect_recordings(
    folder: Path,
    recordings: Sequence[Posed],
    config: ExtractConfig,
    segmentation: SegmentationConfig,
    *,
    register: bool,
    progress: Progress,
    executor: Executor | None = None,
) -> list[Session]:
    """Write the shards of recordings of one place; the same ones, whoever executes it.

    With ``register``, the local clouds of each are aligned with what the ones before it saw, and
    so they are done one after another; otherwise several at a time.

    Returns
    -------
    list of Session
        To be labelled by :func:`~segloc_lab.training.shards.finish`.
    """
    sessions = [item.session for item in recordings]
    tasks = [
        _Task(folder, item, tuple(sessions[:k]), config, segmentation, register)
        for k, item in enumerate(recordings)
    ]
    for together in [[task] for task in tasks] if register else [tasks]:
        for number, text in as_finished(_shard, together, executor):
            progress(f"{together[number].item.session.name}: {text}")
    return sessions


def _shard(task: _Task) -> str:
    """Write a recording's shard, unless it is there, and say what was done."""
    folder, before = task.folder, task.before
    session, recording = task.item.session, task.item.recording
    own = _for_sweeps(task.config) if is_push_broom(recording) else task.config
    options = options_of(
        own,
        segmentation=task.segmentation.model_dump(mode="json"),
        register=task.register,
        before=[one.file for one in before],
        scans=_fingerprint(recording),
    )
    if finished(folder, session, options):
        return "already there"
    registration = _registration(folder, before) if task.register and before else None
    segmenter = Segmenter(task.segmentation)
    extract = extract_session(recording, segmenter.segment, own, registration)
    write_shard(folder, session, extract, options)
    return f"{len(extract)} segments{_told(registration)}"


def _for_sweeps(config: ExtractConfig) -> ExtractConfig:
    """One sweep of a push-broom sensor shows no object, and a short way only slices."""
    return config.model_copy(update={"lengths_m": (config.swathe_m,)})


def _fingerprint(recording: Recording) -> list[int | str]:
    """Which scans there are, and where: with other poses a shard is made anew."""
    poses = b"" if recording.poses is None else recording.poses.tobytes()
    ends = [int(recording.indices[0]), int(recording.indices[-1])]
    return [len(recording), *ends, hashlib.sha256(poses).hexdigest()[:16]]


def _registration(folder: Path, before: Sequence[Session]) -> Registration:
    structure = [read_array(folder, session, "structure") for session in before]
    return Registration(np.concatenate(structure))


def _told(registration: Registration | None) -> str:
    if registration is None:
        return ""
    shift = float(np.median(registration.shifts_m)) if registration.shifts_m else 0.0
    return (
        f"; of its local clouds {registration.accepted} aligned (by {shift:.2f} m, median), "
        f"{registration.rejected} did not fit, {registration.alone} saw nothing known"
    )


def collect_worlds(
    folder: Path,
    worlds: Sequence[WorldSpec],
    config: ExtractConfig,
    segmentation: SegmentationConfig,
    *,
    workers: int,
    progress: Progress,
    executor: Executor | None = None,
) -> list[Session]:
    """Write the shards of simulated worlds, several at a time.

    What is written depends neither on the executor nor on the number of workers.
    """
    tasks = [
        _WorldTask(folder, spec, k, config, segmentation)
        for spec in worlds
        for k in range(len(spec.drives))
    ]
    done: list[Session] = []
    with single_threaded_pool(workers) if executor is None else nullcontext(executor) as pool:
        for _, (session, text) in as_finished(_world, tasks, pool):
            progress(f"{session.place} {session.name}: {text}")
            done.append(session)
    return done


@dataclass(frozen=True)
class _WorldTask:
    """Session k of a world."""

    folder: Path
    spec: WorldSpec
    k: int
    config: ExtractConfig
    segmentation: SegmentationConfig


def _world(task: _WorldTask) -> tuple[Session, str]:
    """One session of one world, in whatever process."""
    folder, spec, k = task.folder, task.spec, task.k
    config, segmentation = task.config, task.segmentation
    session = Session(spec.name, f"session-{k}", spec.drives[k].sensor)
    options = options_of(
        config, segmentation=segmentation.model_dump(mode="json"), spec=spec.model_dump(), k=k
    )
    if finished(folder, session, options):
        return session, "already there"
    segmenter = Segmenter(segmentation)
    drive = simulated_drive(spec, k)
    own = _for_sweeps(config) if sweeps(spec.drives[k]) else config
    extract = extract_session(drive, segmenter.segment, own)
    write_shard(folder, session, extract, options)
    return session, f"{len(extract)} segments ({session.sensor})"
