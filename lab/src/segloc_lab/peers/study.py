"""The comparison with other systems: export, each system in its environment, tables.

Everything is kept: sets that are exported, and the answers that a system gave to the same queries
under the same settings.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from segloc.errors import ConfigError, DatasetError, SeglocError

from ..report import Table
from . import compare
from .export import export
from .sets import SETS

SIDEWAYS = ("--shifts", "-15", "-10", "-5", "0", "5", "10", "15")
_SRC = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Peer:
    """How a system is run.

    Attributes
    ----------
    module : str
        Of this package.
    package : str
        What it needs, as it is imported.
    answers : tuple of str
        Names of its answers.
    settings : tuple of str
        Options.
    by_trait : dict of str to tuple of str
        More options, by the trait of the sets that they suit.
    """

    module: str
    package: str
    answers: tuple[str, ...]
    settings: tuple[str, ...] = ()
    by_trait: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def arguments(self, traits: Sequence[str]) -> tuple[str, ...]:
        """Return the options for a set; the last of its traits counts."""
        return (*self.settings, *(each for t in traits for each in self.by_trait.get(t, ())))


def _segloc(*more: str) -> Peer:
    name = f"segloc-profile{'-alone' if more else ''}"
    return Peer("segloc_query", "segloc", (name,), more)


def _method(name: str) -> Peer:
    answers = (f"segloc-{name}", f"published-{name}")
    return Peer("segloc_query", "segloc", answers, ("--method", name, "--published"))


PAPER = ("segmatch-eigen", "segmatch-esf", "nsm", "segmap", "esm", "dsm")
"""Methods that are compared as published, and as descriptors of segloc."""

_LONG, _SCAN = ("--views", "long"), ("--views", "scan")
_CONTEXTS = {"gathered": _LONG, "beside": SIDEWAYS, "indoors": ("--radius", "50")}

PEERS = {
    "segloc": _segloc(),
    "segments": _segloc("--segments-alone"),
    **{name: _method(name) for name in PAPER},
    "scan-context": Peer(
        "scan_context", "small_gicp", ("scan_context", "scan_context-alone"), (), _CONTEXTS
    ),
    "contour-context": Peer(
        "contour_context",
        "small_gicp",
        ("contour_context", "contour_context-alone"),
        (),
        {"gathered": _LONG},
    ),
    "small-gicp": Peer("small_gicp_query", "small_gicp", ("small_gicp",)),
    "branch-and-bound": Peer(
        "branch_and_bound", "small_gicp", ("branch_and_bound",), (), {"indoors": ("--cell", "0.25")}
    ),
    "kiss-matcher": Peer(
        "kiss_matcher_query",
        "kiss_matcher",
        ("kiss_matcher", "kiss_matcher-inliers"),
        (),
        {**_CONTEXTS, "indoors": ("--radius", "50", "--voxel", "0.3")},
    ),
    "open3d": Peer(
        "open3d_query", "open3d", ("open3d",), (), {"indoors": ("--voxel", "0.5", "--apart", "5")}
    ),
    "map-closures": Peer(
        "map_closures_query",
        "map_closures",
        ("map_closures",),
        ("--views", "short"),
        {"gathered": _LONG, "cloud": _SCAN},
    ),
}


def checked(names: Sequence[str], known: Sequence[str], option: str) -> tuple[str, ...]:
    """Return the names, or raise ConfigError for an unknown one."""
    for name in names:
        if name not in known:
            raise ConfigError(f"{option}: no {name!r}; available: {', '.join(known)}")
    return tuple(dict.fromkeys(names))


def interpreters(given: Sequence[str]) -> dict[str, str]:
    """Parse NAME=PYTHON of systems that have an environment of their own."""
    found = {}
    for each in given:
        name, mark, path = each.partition("=")
        if not mark or not Path(path).is_file():
            raise ConfigError(f"--python {each!r}: pass NAME=PYTHON, PYTHON an interpreter's file")
        found[checked([name], tuple(PEERS), "--python")[0]] = path
    return found


@dataclass(frozen=True)
class Job:
    """What is compared, where, and with what.

    Attributes
    ----------
    out : Path
        Folder of sets and answers.
    data : Path or None
        Folder of recordings.
    every : int
        Every N-th query of each set.
    pythons : dict of str to str
        Interpreters, by the system that needs another than this one.
    say : callable
        Called with a line about what is done.
    """

    out: Path
    data: Path | None
    sets: tuple[str, ...]
    peers: tuple[str, ...]
    every: int = 1
    pythons: Mapping[str, str] = field(default_factory=dict)
    say: Callable[[str], None] = print

    def folder(self, name: str) -> Path:
        """Return the folder of a set."""
        return self.out / (name if self.every == 1 else f"{name}-every{self.every}")

    def run(self) -> list[Table]:
        """Export what is missing, have all systems answer, and return the tables."""
        for name in self.sets:
            needs = SETS[name].needs
            if needs and not self._is_exported(name) and not self._has(needs):
                where = "pass --data DATA" if self.data is None else f"{self.data} has none"
                raise DatasetError(f"set {name}: no folder {needs} of recordings; {where}")
        python = {name: self.pythons.get(name, sys.executable) for name in self.peers}
        missing = {name for name in self.peers if not has(python[name], PEERS[name].package)}
        for name in self.sets:
            self._export(name)
        for name in self.peers:
            if name in missing:
                self.say(f"{name}: {PEERS[name].package} is not installed")
                continue
            for each in self.sets:
                self.say(f"{name} on {each}")
                self._answer(PEERS[name], python[name], each)
        absent = {a: "not installed" for name in missing for a in PEERS[name].answers[:1]}
        systems = {answers for name in self.peers for answers in PEERS[name].answers}
        return compare.tables([self.folder(name) for name in self.sets], systems, absent)

    def _is_exported(self, name: str) -> bool:
        return (self.folder(name) / "queries.npz").is_file()

    def _has(self, folder: str) -> bool:
        return self.data is not None and (self.data / folder).is_dir()

    def _export(self, name: str) -> None:
        if not self._is_exported(name):
            self.say(f"exporting {name}")
            export(self.folder(name), SETS[name], self.data or Path(), self.every)

    def _answer(self, peer: Peer, python: str, name: str) -> None:
        command = [python, "-m", f"segloc_lab.peers.{peer.module}", str(self.folder(name))]
        done = subprocess.run(
            [*command, *peer.arguments(SETS[name].traits)],
            env=environment(),
            capture_output=True,
            text=True,
        )
        if done.returncode:
            last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
            raise SeglocError(f"{peer.module} on {name}: {last}")


def environment() -> dict[str, str]:
    """Return the environment of a system: one thread, and this package beside its own."""
    path = os.pathsep.join(filter(None, (str(_SRC), os.environ.get("PYTHONPATH"))))
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {**os.environ, **single, "PYTHONPATH": path}


def has(python: str, package: str) -> bool:
    """Return whether an interpreter imports a package."""
    done = subprocess.run(
        [python, "-c", f"import {package}"], env=environment(), capture_output=True
    )
    return done.returncode == 0
