"""Make datasets from recordings and simulated worlds."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import Field

from segloc import geometry
from segloc.errors import ConfigError
from segloc.frontend import SegmentationConfig, Segmenter
from segloc.system.processes import as_finished, single_threaded_pool
from segloc.system.section import Section
from segloc.tools.datasets.signature import PUSH_BROOM, sensor_of
from segloc.types import Recording

from ..simulation import (
    PLATFORMS,
    SCENES,
    SENSORS,
    Conditions,
    LineLidar,
    Route,
    SimulatedSequence,
    simulate_session,
)
from ..simulation.drives import lane_scale, mapped_way
from .extract import ExtractConfig, extract_session
from .session_registration import Registration
from .shards import Session, finished, options_of, read_array, stored, write_shard

_SWEEP_SPACING_M = 0.15
_KNOWN_BY = 5  # scans of a recording
_USUAL_SENSORS = ("hdl64e", "hdl64e", "hdl64e", "hdl32e", "vlp16", "os1-64", "os1-128", "lms151")
_CARRIERS = {"town": ("car",), "terraces": ("car",)}
_WALKERS = ("wheeled", "legged", "carried")


class Drive(Section):
    """One session of a world."""

    sensor: str
    thin: int = Field(1, ge=1, description="keep every COUNT-th firing")
    lane_m: float
    reverse: bool
    foliage: float
    replaced: float
    scaffolding: float
    carrier: str = Field(description="one of PLATFORMS")
    raised_m: float = Field(description="height of the sensor above its usual position")


class WorldSpec(Section):
    """A world and its sessions; reproducible."""

    scene: str
    seed: int = Field(ge=0)
    length_m: float = Field(500.0, gt=0, description="length of each drive")
    drives: tuple[Drive, ...]

    @property
    def name(self) -> str:
        return f"{self.scene}-{self.seed}"


def draw_worlds(
    text: str,
    seed: int,
    *,
    length_m: float = 500.0,
    sensors: tuple[str, ...] = (),
    thin: int = 1,
) -> list[WorldSpec]:
    """Draw worlds as specified by ``town:10,park:4``.

    Each has two or three sessions in different lanes and seasons, some in reverse, with some
    objects replaced, each with its own sensor and platform.
    """
    if not 0 < length_m < math.inf:
        raise ConfigError(f"a drive must have a positive number of metres, not {length_m}")
    wanted = sensors or _USUAL_SENSORS
    for name in wanted:
        if name not in SENSORS:
            raise ConfigError(f"no sensor {name!r}; available: {', '.join(sorted(SENSORS))}")
    specs: list[WorldSpec] = []
    for part in text.split(","):
        scene, _, number = part.strip().partition(":")
        if scene not in SCENES:
            raise ConfigError(f"no scene {scene!r}; available: {', '.join(sorted(SCENES))}")
        if not number.isdecimal() or not 0 < int(number) <= 10_000:
            raise ConfigError(f"{part.strip()!r} has no number of worlds: write {scene}:10")
        specs += [_draw(scene, seed, i, length_m, wanted, thin) for i in range(int(number))]
    return specs


def _draw(
    scene: str, seed: int, i: int, length_m: float, sensors: tuple[str, ...], thin: int
) -> WorldSpec:
    rng = np.random.default_rng([seed, i, *scene.encode()])
    drives = tuple(
        Drive(
            sensor=str(rng.choice(sensors)),
            thin=thin,
            lane_m=float(rng.uniform(-0.3, 1.9)),
            reverse=bool(k > 0 and rng.random() < 0.5),
            foliage=float(rng.choice([0.0, 1.0]) if rng.random() < 0.5 else rng.random()),
            replaced=float(rng.uniform(0.0, 0.3)),
            scaffolding=float(rng.uniform(0.0, 0.1)),
            carrier=str(rng.choice(_CARRIERS.get(scene, _WALKERS))),
            raised_m=float(rng.uniform(-0.15, 0.35)),
        )
        for k in range(int(rng.integers(2, 4)))
    )
    return WorldSpec(scene=scene, seed=10_000 * seed + i, length_m=length_m, drives=drives)


def simulated_drive(spec: WorldSpec, k: int) -> SimulatedSequence:
    """Simulate session k of a world, with true poses; sessions share most of their route."""
    drive = spec.drives[k]
    world = SCENES[spec.scene](spec.seed)
    sensor = SENSORS[drive.sensor]().thinned(drive.thin)
    rng = np.random.default_rng([spec.seed, 31])
    way = mapped_way(world, rng, spec.length_m)
    route = Route(
        tuple(way[::-1] if drive.reverse else way),
        drive.lane_m * lane_scale(world),
        _SWEEP_SPACING_M if sweeps(drive) else 2.0,
        spec.length_m,
    )
    conditions = Conditions(drive.foliage, drive.replaced, drive.scaffolding)
    carrier = PLATFORMS[drive.carrier]()
    carrier = replace(carrier, mount_height_m=carrier.mount_height_m + drive.raised_m)
    return simulate_session(
        world, k, route, sensor, spec.seed, conditions=conditions, platform=carrier
    )


def sweeps(drive: Drive) -> bool:
    """Return whether the sensor is a push-broom LiDAR, which needs motion."""
    return isinstance(SENSORS[drive.sensor](), LineLidar)


Progress = Callable[[str], None]


@dataclass(frozen=True)
class Posed:
    """A recording with poses as a session of a place."""

    session: Session
    recording: Recording


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
    """Write the shards of recordings of one place, independently of the executor.

    With ``register``, the local clouds of each are aligned with the sessions before it, one session
    after another; otherwise sessions are processed in parallel.

    Returns
    -------
    list of Session
        For :func:`~segloc_lab.training.shards.finish`.
    """
    sessions = [item.session for item in recordings]
    write = partial(_write_recording, folder, config, segmentation, register)
    tasks = [(item, sessions[:k]) for k, item in enumerate(recordings)]
    for together in [[task] for task in tasks] if register else [tasks]:
        for number, text in as_finished(write, together, executor):
            progress(f"{together[number][0].session.name}: {text}")
    return sessions


def _write_recording(
    folder: Path,
    config: ExtractConfig,
    segmentation: SegmentationConfig,
    register: bool,
    task: tuple[Posed, list[Session]],
) -> str:
    """Write a recording's shard, after the sessions before it, and return a summary."""
    item, before = task
    session, recording = item.session, item.recording
    own = _for_sweeps(config) if sensor_of(recording) == PUSH_BROOM else config
    scans = _fingerprint(recording)
    options = options_of(
        own,
        segmentation=segmentation.model_dump(mode="json"),
        before=[stored(folder, one, "options") for one in before] if register else [],
        scans=scans,
    )
    if finished(folder, session, options):
        return "exists"
    registration = None
    if register and before:
        structure = [read_array(folder, one, "structure") for one in before]
        registration = Registration(np.concatenate(structure))
    extract = extract_session(recording, Segmenter(segmentation).segment, own, registration)
    write_shard(folder, session, extract, options, scans)
    return f"{len(extract)} segments{_told(registration)}"


def _for_sweeps(config: ExtractConfig) -> ExtractConfig:
    """Use longer clouds for push-broom sensors: single sweeps show no objects."""
    return config.model_copy(update={"lengths_m": (config.swathe_m,)})


def _fingerprint(recording: Recording) -> str:
    """Return a hash of poses, numbers, and some of the scans, by which they are known again."""
    digest = hashlib.sha256(b"" if recording.poses is None else recording.poses.tobytes())
    digest.update(recording.indices.tobytes())
    for i in geometry.spread(len(recording), _KNOWN_BY):
        digest.update(recording.scan(i).points.tobytes())
    return digest.hexdigest()[:16]


def _told(registration: Registration | None) -> str:
    if registration is None:
        return ""
    shift = float(np.median(registration.shifts_m)) if registration.shifts_m else 0.0
    return (
        f"; local clouds: {registration.accepted} aligned (by {shift:.2f} m, median), "
        f"{registration.rejected} rejected, {registration.alone} without known structure"
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
    """Write the shards of simulated worlds in parallel.

    The result does not depend on the executor or the number of workers.
    """
    write = partial(_write_drive, folder, config, segmentation)
    drives = [(spec, k) for spec in worlds for k in range(len(spec.drives))]
    done: list[Session] = []
    with single_threaded_pool(workers) if executor is None else nullcontext(executor) as pool:
        for _, (session, text) in as_finished(write, drives, pool):
            progress(f"{session.place} {session.name}: {text}")
            done.append(session)
    return done


def _write_drive(
    folder: Path,
    config: ExtractConfig,
    segmentation: SegmentationConfig,
    drive: tuple[WorldSpec, int],
) -> tuple[Session, str]:
    """Write session k of a world."""
    spec, k = drive
    session = Session(spec.name, f"session-{k}", spec.drives[k].sensor)
    options = options_of(
        config, segmentation=segmentation.model_dump(mode="json"), spec=spec.model_dump(), k=k
    )
    if finished(folder, session, options):
        return session, "exists"
    own = _for_sweeps(config) if sweeps(spec.drives[k]) else config
    extract = extract_session(simulated_drive(spec, k), Segmenter(segmentation).segment, own)
    write_shard(folder, session, extract, options)
    return session, f"{len(extract)} segments ({session.sensor})"
