"""Workspace of the paper's studies: a folder, simulated test sets, and KITTI if available."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from segloc.errors import ConfigError

from ...evaluation import workspace
from ...evaluation.study import Study
from ...simulation.suites import PAPER, SUITES, TestSet

SCALES = ("small", "full", PAPER)


@dataclass(frozen=True, kw_only=True)
class Workspace(workspace.Workspace):
    """Folder, data and resources of an evaluation.

    Attributes
    ----------
    suite, scale : str
        Of :data:`.simulation.suites.SUITES`; "small", "full", or "paper": poses are requested
        as often and as far along as in the paper, which takes hours.
    only : tuple of str or None
        Of the test sets of the suite only these.
    data : Path or None
        KITTI odometry 00: keyframes, scans and their poses, as ``protocols/kitti00.sh`` reads it.
    """

    suite: str = "six"
    scale: str = "small"
    only: tuple[str, ...] | None = None
    data: Path | None = None

    def __post_init__(self) -> None:
        if self.scale not in SCALES:
            raise ConfigError(f"scale must be one of {', '.join(SCALES)}, not {self.scale!r}")
        if self.suite not in SUITES:
            raise ConfigError(f"suite must be one of {', '.join(SUITES)}, not {self.suite!r}")
        names = [test.name for test in SUITES[self.suite]]
        if unknown := set(self.only or ()) - set(names):
            raise ConfigError(
                f"no set {', '.join(sorted(unknown))} in {self.suite}; there are {', '.join(names)}"
            )

    @property
    def effort(self) -> str:
        """Scale of everything except the test sets."""
        return "full" if self.scale == PAPER else self.scale

    @property
    def sets(self) -> tuple[TestSet, ...]:
        """Return the test sets of the suite, or the requested ones."""
        tests = SUITES[self.suite]
        return tests if self.only is None else tuple(t for t in tests if t.name in self.only)

    def facts(self, seconds: float, fingerprints: Mapping[str, str]) -> dict[str, Any]:
        """Return the facts that repeat a study."""
        data = None if self.data is None else self.data.name
        only = None if self.only is None else [test.name for test in self.sets]
        own = {"suite": self.suite, "scale": self.scale, "only": only, "data": data}
        return {**super().facts(seconds, fingerprints), **own}


STUDIES = ("roc", "generalization", "rotation", "sampling", "localization", "timing", "memory")
"""Each is run by the module of its name in this package."""


def run(name: str, workspace: Workspace) -> Study:
    """Run one of :data:`STUDIES` and store it in a folder of the workspace."""
    module = importlib.import_module(f"{__package__}.{name}")
    study = cast(Callable[[Workspace], Study], module.run)(workspace)
    study.save(workspace.out / study.name)
    return study
