"""Settings of a training run, from a file and a command line."""

from __future__ import annotations

import math
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from segloc.config import validated
from segloc.descriptors.pointset import Alignment
from segloc.errors import MissingDependency
from segloc.system.section import Section, read_yaml

from .augment import AugmentConfig, Sampler
from .dataset import FAR_M

Loss = Literal["info_nce", "triplet", "esm", "multi_similarity"]
HeadKind = Literal["linear", "quadratic", "two_layer"]
PairTraining = Literal["joint", "frozen"]
PairNegatives = Literal["batch", "any"]
PUBLISHED: dict[str, dict[str, Any]] = {"segmap": {"learning_rate": 1e-4, "hard_share": 0.0}}
"""What a network's own paper sets, where it is not the default here."""


class TrainConfig(Section):
    """Everything that decides how a network comes out."""

    network: str = Field("dsm", description="one of training.tasks.MODULES")
    alignment: Alignment = "pca2d"
    sampler: Sampler = "farthest"
    loss: Loss = "info_nce"
    pair_weight: float = Field(
        0.1, ge=0, description="weight of FC4's loss beside the descriptor's; 0: no FC4"
    )
    pair_head: HeadKind = Field("two_layer", description="the form of FC4")
    pair_training: PairTraining = Field(
        "frozen", description="with the descriptor, or after it on finished ones of held-out places"
    )
    pair_negatives: PairNegatives = Field(
        "any",
        description="pairs that do not match: mined ones beside others, or random ones, too",
    )
    steps: int = Field(3000, ge=1)
    classes: int = Field(32, ge=2, description="objects a batch")
    views: int = Field(2, ge=2, description="segments of each object a batch")
    across: float = Field(
        0.8, ge=0, le=1, description="chance that these are of different sessions if possible"
    )
    different_m: float = Field(
        FAR_M, gt=0, description="segments of one world differ beyond this distance"
    )
    hard_share: float = Field(0.5, ge=0, le=1, description="objects chosen to be mistakable")
    mine_every: int = Field(500, ge=1, description="steps between searches for such objects")
    mine_objects: int = Field(12_000, ge=100, description="objects among which it searches")
    learning_rate: float = Field(2e-3, gt=0)
    warmup: int = Field(100, ge=0, description="steps until the full learning rate")
    weight_decay: float = Field(1e-5, ge=0)
    clip: float = Field(5.0, gt=0, description="largest norm of the gradient")
    augmentation: AugmentConfig = AugmentConfig()
    validation_share: float = Field(0.15, gt=0, lt=1)
    validation_limit: int = Field(3000, ge=1, description="segments that validation looks at")
    quality_limit: int = Field(20000, ge=1, description="segments the quality head is fitted to")
    validate_every: int = Field(250, ge=1)
    patience: int = Field(8, ge=1, description="validations without a better one until the end")
    max_minutes: float = Field(math.inf, gt=0, allow_inf_nan=True)
    threads: int = Field(1, ge=1)
    device: Literal["cpu", "cuda"] = "cpu"
    precision: Literal["auto", "float32", "bfloat16"] = Field(
        "auto", description="of the products; auto is bfloat16 on a GPU"
    )
    seed: int = Field(0, ge=0)


def require_torch() -> None:
    """Say what to install before anything else is done.

    Raises
    ------
    MissingDependency
        If there is no PyTorch.
    """
    if find_spec("torch") is None:
        raise MissingDependency("torch", "train", "training")


def load_train_config(path: Path | None, given: dict[str, Any]) -> TrainConfig:
    """A configuration file, if there is one, with what the command line gives on top.

    Raises
    ------
    ConfigError
        If the file cannot be read, or a name or a value is wrong.
    """
    values = {**({} if path is None else read_yaml(path)), **given}
    published = PUBLISHED.get(str(values.get("network", "dsm")), {})
    return validated(TrainConfig, {**published, **values}, str(path or "training"))
