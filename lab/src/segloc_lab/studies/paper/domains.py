"""The surroundings in which descriptors are compared, as datasets of labelled segments."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ...training.dataset import SegmentDataset
from ...training.shards import load_dataset
from .domain_segments import RECORDED, SIMULATED, DomainSize, recorded, simulated
from .workspace import Workspace

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
    """The datasets of a workspace, made where they are missing, each read once.

    Parameters
    ----------
    workspace : Workspace
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
        """All that there are: the simulated ones, and KITTI 00 where the workspace has data."""
        return SIMULATED if self._workspace.data is None else (*SIMULATED, RECORDED)

    def folder(self, domain: str, split: str) -> Path:
        """Where the segments of a domain lie; see :func:`simulated` and :func:`recorded`."""
        if (domain, split) not in self._folders:
            self._folders[domain, split] = self._made(domain, split)
        return self._folders[domain, split]

    def _made(self, domain: str, split: str) -> Path:
        space, root = self._workspace, self._workspace.out / "datasets"
        if domain == RECORDED and space.data is not None:
            return recorded(root, space.data, split, say=space.say)
        size = self._sizes[domain]
        with space.progress(f"Simulating {domain} ({split})") as update:
            return simulated(
                root,
                domain,
                split,
                size,
                seed=space.seed,
                workers=space.workers,
                executor=space.executor,
                progress=update,
            )

    def dataset(self, domain: str, split: str) -> SegmentDataset:
        """The segments of a domain."""
        folder = self.folder(domain, split)
        if folder not in self._read:
            self._read[folder] = load_dataset(folder)
        return self._read[folder]
