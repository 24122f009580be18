"""Domains in which descriptors are compared, as datasets of labelled segments."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from segloc import __version__
from segloc.errors import ConfigError, DatasetError
from segloc.frontend import SegmentationConfig, Segmenter
from segloc.tools.datasets import Sequence

from ... import kitti00
from ...recordings import Surveyed
from ...simulation import LineLidar, SimulatedSequence
from ...simulation.suites import SIX, SWATHE_M, TestSet
from ...swathes import Swathes
from ...training.collect import Posed, collect_recordings
from ...training.dataset import SegmentDataset
from ...training.extract import ExtractConfig, extract_session
from ...training.shards import (
    INDEX,
    Session,
    finish,
    finished,
    load_dataset,
    options_of,
    write_shard,
)
from .workspace import Workspace

SIMULATED = ("kitti", "burgess", "robotcar")
RECORDED = "kitti00"
SPLITS = ("train", "test")

_EXTRACT = ExtractConfig(lengths_m=(40.0, 16.0), swathe_m=SWATHE_M)
_PLACES: dict[str, dict[str, tuple[str, ...]]] = {
    "train": {
        "loop": ("169:373", "1414:1600"),
        "street-655": ("655:947",),
        "street-1004": ("1004:1360",),
        "street-1601": ("1601:1820",),
    },
    "test": {
        "square": ("948:999", "1361:1413"),
        "start": ("48:81", "619:654"),
        "corner": ("158:170", "988:1003"),
    },
}
"""Key frames of KITTI 00 by place, one range per pass."""


@dataclass(frozen=True)
class DomainSize:
    """Size of a simulated domain.

    Attributes
    ----------
    train, test : int
        Worlds. Those of training have two sessions, those of tests the number of the test set.
    scale : str
        Of the test sets: how large a world is, and how far each session leads.
    """

    train: int
    test: int
    scale: str

    def worlds(self, split: str) -> int:
        """Number of worlds of a split."""
        return self.train if split == "train" else self.test


@dataclass(frozen=True)
class _Job:
    """One session of one world of a simulated domain."""

    folder: Path
    domain: str
    split: str
    scale: str
    seed: int
    session: int

    def drive(self) -> Sequence:
        """Return the session; its scans are cast on access."""
        if self.split == "train":
            return _suite(self.domain).training(1, self.scale, seed=self.seed)[self.session]
        return list(_suite(self.domain).sessions(self.scale, seed=self.seed).values())[self.session]


def _suite(domain: str) -> TestSet:
    return next(each for each in SIX if each.name == domain)


def _jobs(folder: Path, domain: str, split: str, size: DomainSize, seed: int) -> list[_Job]:
    suite = _suite(domain)
    sessions = 2 if split == "train" else 1 + len(suite.tests)
    return [
        _Job(folder, domain, split, size.scale, seed + world, session)
        for world in range(size.worlds(split))
        for session in range(sessions)
    ]


def simulated(space: Workspace, domain: str, split: str, size: DomainSize) -> Path:
    """Make the segments of a simulated domain in a folder named by its settings, unless they exist.

    What was made before an interruption is kept. The result depends neither on the number of
    workers nor on interruptions.

    Returns
    -------
    Path
        The dataset, for :func:`segloc_lab.training.shards.load_dataset`.
    """
    if domain not in SIMULATED or split not in SPLITS:
        raise ConfigError(f"no domain {domain!r} with a split {split!r}")
    first = space.seed + _suite(domain).first_seed
    key = [domain, split, size.worlds(split), size.scale, first, _EXTRACT.model_dump(mode="json")]
    folder = space.out / "datasets" / f"{domain}-{split}-{_hash(key)}"
    if (folder / INDEX).exists():
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    jobs = _jobs(folder, domain, split, size, space.seed)
    made = space.each(f"Simulating {domain} ({split})", _simulate, jobs)
    finish(folder, [session for _, session in made], _EXTRACT.label)
    return folder


def _simulate(job: _Job) -> Session:
    """Write the shard of one session in any process."""
    name = f"{job.domain}-{job.split}-{job.seed}"
    session = Session(name, f"session-{job.session}", _suite(job.domain).sensor)
    segmentation = SegmentationConfig()
    options = options_of(
        _EXTRACT, segmentation=segmentation.model_dump(mode="json"), scale=job.scale
    )
    if finished(job.folder, session, options):
        return session
    drive = job.drive()
    source = drive.source if isinstance(drive, Swathes) else drive
    assert isinstance(source, SimulatedSequence)  # what test sets are made of
    lengths = (SWATHE_M,) if isinstance(source.sensor, LineLidar) else _EXTRACT.lengths_m
    config = _EXTRACT.model_copy(update={"lengths_m": lengths})
    extract = extract_session(Surveyed(source), Segmenter(segmentation).segment, config)
    write_shard(job.folder, session, extract, options)
    return session


def recorded(root: Path, data: Path, split: str, *, say: Callable[[str], None] = print) -> Path:
    """Make the segments of KITTI odometry 00, unless they exist; splits share no place.

    The passes over a place are aligned with each other, since the positions of the reference agree
    to about a metre only. ``say`` takes a line for each pass.
    """
    if split not in SPLITS:
        raise ConfigError(f"no split {split!r} of {RECORDED}")
    poses = data / "keyframes.tum"
    if not poses.is_file():
        raise DatasetError(f"{poses}: no such file")
    key = [poses.read_text("utf-8"), _PLACES[split], _EXTRACT.model_dump(mode="json")]
    folder = root / f"{RECORDED}-{split}-{_hash(key)}"
    if (folder / INDEX).exists():
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    sessions: list[Session] = []
    for place, passes in _PLACES[split].items():
        items = [
            Posed(Session(place, f"{k:02d}-keyframes", "hdl64e"), kitti00.keyframes(data, select))
            for k, select in enumerate(passes)
        ]
        sessions += collect_recordings(
            folder, items, _EXTRACT, SegmentationConfig(), register=True, progress=say
        )
    finish(folder, sessions, _EXTRACT.label)
    return folder


def _hash(key: object) -> str:
    text = json.dumps([__version__, key], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:8]


SIZES: dict[str, dict[str, DomainSize]] = {
    "small": {
        "kitti": DomainSize(3, 2, "small"),
        "burgess": DomainSize(12, 4, "small"),
        "robotcar": DomainSize(6, 2, "small"),
    },
    "full": {
        "kitti": DomainSize(3, 1, "full"),
        "burgess": DomainSize(12, 3, "full"),
        "robotcar": DomainSize(8, 2, "full"),
    },
}
"""By scale and domain. A world of ``kitti`` has ten times as many segments as one of ``burgess``;
all datasets of the small scale take four minutes of one core, those of the full one forty."""


class Domains:
    """The datasets of a workspace, made if missing, each read once.

    Parameters
    ----------
    sizes : dict of str to DomainSize, optional
        By simulated domain; by default those of the workspace's scale.
    """

    def __init__(self, workspace: Workspace, sizes: Mapping[str, DomainSize] | None = None) -> None:
        self._workspace = workspace
        self._sizes = SIZES[workspace.effort] if sizes is None else sizes
        self._folders: dict[tuple[str, str], Path] = {}
        self._read: dict[Path, SegmentDataset] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Return all domains: the simulated ones, and KITTI 00 if available."""
        return SIMULATED if self._workspace.data is None else (*SIMULATED, RECORDED)

    def folder(self, domain: str, split: str) -> Path:
        """Return the folder of a domain's segments; see :func:`simulated` and :func:`recorded`."""
        if (domain, split) not in self._folders:
            self._folders[domain, split] = self._made(domain, split)
        return self._folders[domain, split]

    def _made(self, domain: str, split: str) -> Path:
        space = self._workspace
        if domain == RECORDED and space.data is not None:
            return recorded(space.out / "datasets", space.data, split, say=space.say)
        return simulated(space, domain, split, self._sizes[domain])

    def dataset(self, domain: str, split: str) -> SegmentDataset:
        """Return the segments of a domain."""
        folder = self.folder(domain, split)
        if folder not in self._read:
            self._read[folder] = load_dataset(folder)
        return self._read[folder]
