"""Short trainings of every trainable method in parallel, each done once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from segloc import __version__
from segloc.descriptors import create
from segloc.descriptors.base import Descriptor
from segloc.descriptors.pointset import Judge, PointSetDescriptor
from segloc.descriptors.profile import ProfileDescriptor
from segloc.descriptors.random_forest import PairForest
from segloc.descriptors.segmap import SegMapDescriptor

from ...evaluation.comparison import QUALITY
from ...evaluation.workspace import mute
from ...training.config import TrainConfig, require_torch
from ...training.grow_forest import ForestConfig, train_forest
from ...training.shards import INDEX, load_dataset
from .workspace import Workspace

NETWORKS = ("dsm", "esm", "segmap", "profile")
FORESTS = ("segmatch-eigen", "segmatch-esf", "nsm")

_WIDE = 1000
_OWN: dict[str, dict[str, Any]] = {"segmap": {"learning_rate": 1e-3, "hard_share": 0.0}}


@dataclass(frozen=True)
class Effort:
    """Duration of trainings for a comparison.

    Attributes
    ----------
    steps : dict of str to int
        By network.
    forest_queries, forest_segments : int
        Segments whose candidates a forest is grown on, and segments in all.
    """

    steps: Mapping[str, int]
    forest_queries: int
    forest_segments: int

    def config(self, method: str, seed: int = 0) -> TrainConfig | ForestConfig:
        """Return the settings of a method's training.

        A forest that prunes learns from candidates that look alike, and is meaningless for
        pairs that do not. Here it is to judge any pair, so it sees 1000 candidates of small maps.
        """
        if method in FORESTS:
            return ForestConfig(
                queries=self.forest_queries,
                segments=self.forest_segments,
                neighbours=_WIDE,
                map_segments=_WIDE,
                seed=seed,
            )
        return network_config(method, self.steps[method], seed=seed)


EFFORTS = {
    "small": Effort({"dsm": 500, "esm": 120, "segmap": 60, "profile": 500}, 4_000, 30_000),
    "full": Effort({"dsm": 3000, "esm": 600, "segmap": 200, "profile": 3000}, 8_000, 60_000),
}
"""By scale. Every network gets about the same time of one core, half a minute (small) or three
minutes (full): methods then also differ in how fast they learn."""


@dataclass(frozen=True)
class Training:
    """Training of one method on one dataset.

    Attributes
    ----------
    method : str
        One of :data:`NETWORKS` or :data:`FORESTS`.
    data : Path
        The dataset.
    root : Path
        Where weights are kept.
    """

    method: str
    data: Path
    config: TrainConfig | ForestConfig
    root: Path

    @property
    def out(self) -> Path:
        """Return the file of the weights, named by method, configuration and dataset."""
        digest = hashlib.sha256((self.data / INDEX).read_bytes())
        key = [__version__, self.method, self.data.name, self.config.model_dump(mode="json")]
        digest.update(json.dumps(key, sort_keys=True).encode())
        name = f"{self.method}-{self.data.name}-{digest.hexdigest()[:8]}"
        return self.root / f"{name}.safetensors"


def network_config(network: str, steps: int, *, seed: int = 0, **more: Any) -> TrainConfig:
    """Return the settings of a short training on one thread.

    They are those of :class:`TrainConfig`, but warm-up, mining and validation fit the few steps;
    of SegMap the learning rate and the choice of objects, too.
    """
    values: dict[str, Any] = {
        "network": network,
        "steps": steps,
        "warmup": min(100, steps // 10),
        "mine_every": max(1, steps // 5),
        "mine_objects": 3000,
        "validate_every": max(1, steps // 2),
        "validation_limit": 1000,
        "quality_limit": 4000,
        "seed": seed,
    }
    return TrainConfig(**{**values, **_OWN.get(network, {}), **more})


def trained(workspace: Workspace, trainings: Sequence[Training]) -> list[Path]:
    """Return the weights of every training, in order; existing ones are reused.

    An interrupted training resumes. Each takes one thread, so results do not depend on the number
    of processes or the executor.
    """
    missing = [each for each in trainings if not each.out.exists()]
    if any(each.method in NETWORKS for each in missing):
        require_torch()
    missing.sort(key=_order)  # long ones first: at the end no process waits for another
    list(workspace.each("Training", _train, missing))
    return [each.out for each in trainings]


def trained_dsm(
    workspace: Workspace, data: Path, steps: int, settings: Sequence[Mapping[str, Any]]
) -> list[Path]:
    """Do :func:`trained` for DSM with each of some settings of :class:`TrainConfig`."""
    configs = [network_config("dsm", steps, seed=workspace.seed, **each) for each in settings]
    root = workspace.out / "models"
    return trained(workspace, [Training("dsm", data, config, root) for config in configs])


def _order(training: Training) -> int:
    slow = ("esm", "segmap", "dsm")
    return slow.index(training.method) if training.method in slow else len(slow)


def _train(training: Training) -> None:
    """Run one training in any process."""
    training.root.mkdir(parents=True, exist_ok=True)
    dataset, config = load_dataset(training.data), training.config
    card = {"data": training.data.name, "licence": "for evaluation only"}
    if isinstance(config, ForestConfig):
        train_forest(dataset, training.out, training.method, config, card, mute)
        return
    from ...training.train import train

    train(dataset, training.out, config, card, mute)
    training.out.with_suffix(".checkpoint").unlink()


def load_method(method: str, weights: Path | None) -> Descriptor:
    """Return a method with given weights, or with the shipped ones.

    Parameters
    ----------
    method : str
        A registered name.
    weights : Path or None
        Of the network, or of the forest for a method that has one; None for what is shipped.
    """
    if weights is None or method == "geo":
        return create(method, 1)
    if method in FORESTS:
        descriptor = create(method, 1)
        descriptor.pruner = PairForest.load(weights, descriptor)
        return descriptor
    if method == "segmap":
        return SegMapDescriptor(weights, 1)
    if method == "profile":
        return ProfileDescriptor(weights, 1)
    judge: Judge = "pair" if method.endswith(QUALITY) else "nearest"
    return PointSetDescriptor(method, weights, judge=judge, threads=1)


def source_of(method: str) -> str:
    """Return the training of a method's weights; variants with and without quality share it."""
    return method.removesuffix(QUALITY)
