"""Settings of a training run, from a file and the command line."""

from __future__ import annotations

import math
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from segloc.config import validate
from segloc.descriptors.pointset import Alignment
from segloc.errors import MissingDependency
from segloc.system import kernels
from segloc.system.section import Section, read_yaml
from segloc.types import Float32

from .dataset import FAR_M, SegmentDataset

Sampler = Literal["farthest", "random", "inverse_density"]

_DENSITY_NEIGHBORS = 16


class AugmentConfig(Section):
    """Strength of the augmentation of training segments."""

    yaw: bool = Field(True, description="turn by a random angle about z")
    drop: float = Field(0.1, ge=0, lt=1, description="maximum share of points dropped at random")
    occlude: float = Field(0.3, ge=0, lt=1, description="maximum share cut off by a half-space")
    occlude_chance: float = Field(0.5, ge=0, le=1)
    thin: float = Field(0.5, ge=0, lt=1, description="maximum share thinned out from one side")
    thin_chance: float = Field(0.3, ge=0, le=1)
    noise_m: float = Field(0.02, ge=0, description="standard deviation of added noise")
    min_points: int = Field(20, ge=1, description="minimum number of points kept")


def augment(points: Float32, config: AugmentConfig, rng: np.random.Generator) -> Float32:
    """Return an augmented copy of a segment.

    In this order: drop random points, cut off a half-space (occlusion), thin towards one side
    (distance), add noise, and turn about z.
    """
    result = _drop(points, config, rng)
    if rng.random() < config.occlude_chance:
        result = _occlude(result, config, rng)
    if rng.random() < config.thin_chance:
        result = _thin(result, config, rng)
    result = result + config.noise_m * rng.standard_normal(result.shape, dtype=np.float32)
    if config.yaw:
        result = result @ _yaw(rng.uniform(0.0, 2 * np.pi)).T
    return np.ascontiguousarray(result, dtype=np.float32)


def points_of(
    dataset: SegmentDataset,
    indices: NDArray[np.int64],
    config: AugmentConfig,
    rng: np.random.Generator | None = None,
) -> list[Float32]:
    """Return the points of segments; augmented if a generator is given."""
    parts = [dataset.segment(int(i)) for i in indices]
    return parts if rng is None else [augment(part, config, rng) for part in parts]


def _drop(points: Float32, config: AugmentConfig, rng: np.random.Generator) -> Float32:
    share = rng.uniform(0.0, config.drop)
    return _enough(points, rng.random(len(points)) >= share, config)


def _occlude(points: Float32, config: AugmentConfig, rng: np.random.Generator) -> Float32:
    normal = rng.standard_normal(3)
    normal[2] *= 0.3  # mostly vertical planes
    along = points @ normal.astype(np.float32)
    return _enough(points, along >= np.quantile(along, rng.uniform(0.0, config.occlude)), config)


def _thin(points: Float32, config: AugmentConfig, rng: np.random.Generator) -> Float32:
    angle = rng.uniform(0.0, 2 * np.pi)
    along = points[:, :2] @ np.array([np.cos(angle), np.sin(angle)], np.float32)
    span = float(np.ptp(along)) or 1.0
    loss = rng.uniform(0.0, 2 * config.thin) * (along - along.min()) / span
    return _enough(points, rng.random(len(points)) >= loss, config)


def _enough(points: Float32, keep: np.ndarray, config: AugmentConfig) -> Float32:
    return points[keep] if keep.sum() >= config.min_points else points


def _yaw(angle: float) -> Float32:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.float32)


def reorder(prepared: Float32, sampler: Sampler, rng: np.random.Generator) -> Float32:
    """Return prepared segments (P, N, 3) with points in the sampler's order.

    "farthest" keeps the order. "random" is uniform. "inverse_density" draws without replacement
    with a probability proportional to the mean squared distance to a point's neighbours, as in
    PointCNN.
    """
    if sampler == "farthest" or len(prepared) == 0:
        return prepared
    keys = np.log(rng.random(prepared.shape[:2]))
    if sampler == "inverse_density":
        # Efraimidis and Spirakis: sorted by u^(1/w), each prefix is a weighted sample.
        keys /= np.maximum(_spacing(prepared), 1e-12)
    order = np.argsort(-keys, axis=1)
    return np.ascontiguousarray(np.take_along_axis(prepared, order[..., None], axis=1))


def _spacing(prepared: Float32) -> Float32:
    """Return the mean squared distance of each point to its neighbours, (P, N)."""
    P, N, _ = prepared.shape
    index = kernels.dilated_neighbors(prepared, N, N, min(_DENSITY_NEIGHBORS, N), 1, 1)
    near = prepared[np.arange(P)[:, None, None], index]
    return np.square(near - prepared[:, :, None]).sum(axis=-1).mean(axis=-1)


Loss = Literal["info_nce", "triplet", "esm", "multi_similarity"]
HeadKind = Literal["linear", "quadratic", "two_layer"]
PairTraining = Literal["joint", "frozen"]
PairNegatives = Literal["batch", "any"]
PUBLISHED: dict[str, dict[str, Any]] = {"segmap": {"learning_rate": 1e-4, "hard_share": 0.0}}
"""Settings of a network's own paper that differ from the defaults here."""


class TrainConfig(Section):
    """Settings of a training run."""

    network: str = Field("dsm", description="one of training.tasks.MODULES")
    alignment: Alignment = "pca2d"
    sampler: Sampler = "farthest"
    loss: Loss = "info_nce"
    pair_weight: float = Field(
        0.1, ge=0, description="weight of FC4's loss relative to the descriptor's; 0: no FC4"
    )
    pair_head: HeadKind = Field("two_layer", description="form of FC4")
    pair_training: PairTraining = Field(
        "frozen", description="jointly with the descriptor, or afterwards on held-out places"
    )
    pair_negatives: PairNegatives = Field(
        "any",
        description="different pairs: mined and other ones, or also random ones",
    )
    steps: int = Field(3000, ge=1)
    classes: int = Field(32, ge=2, description="objects per batch")
    views: int = Field(2, ge=2, description="segments per object in a batch")
    across: float = Field(
        0.8, ge=0, le=1, description="probability of views of different sessions, if possible"
    )
    different_m: float = Field(
        FAR_M, gt=0, description="segments of one world farther apart show different objects"
    )
    hard_share: float = Field(0.5, ge=0, le=1, description="share of hard objects in a batch")
    mine_every: int = Field(500, ge=1, description="steps between searches for hard objects")
    mine_objects: int = Field(12_000, ge=100, description="objects searched")
    learning_rate: float = Field(2e-3, gt=0)
    warmup: int = Field(100, ge=0, description="steps until the full learning rate")
    weight_decay: float = Field(1e-5, ge=0)
    clip: float = Field(5.0, gt=0, description="maximum norm of the gradient")
    augmentation: AugmentConfig = AugmentConfig()
    validation_share: float = Field(0.15, gt=0, lt=1)
    validation_limit: int = Field(3000, ge=1, description="segments used in validation")
    quality_limit: int = Field(20000, ge=1, description="segments used to fit the quality head")
    validate_every: int = Field(250, ge=1)
    patience: int = Field(8, ge=1, description="validations without improvement until the end")
    max_minutes: float = Field(math.inf, gt=0, allow_inf_nan=True)
    threads: int = Field(1, ge=1)
    device: Literal["cpu", "cuda"] = "cpu"
    precision: Literal["auto", "float32", "bfloat16"] = Field(
        "auto", description="precision of products; auto: bfloat16 on a GPU"
    )
    seed: int = Field(0, ge=0)


def require_torch() -> None:
    """Raise MissingDependency if PyTorch is missing, before anything else is done."""
    if find_spec("torch") is None:
        raise MissingDependency("torch", "lab", "training")


def load_train_config(path: Path | None, given: dict[str, Any]) -> TrainConfig:
    """Read a configuration file, if given, and override it with options."""
    read = {} if path is None else read_yaml(path)
    if path is not None:  # a fault of an option is not the file's
        validate(TrainConfig, {**_published(read), **read}, str(path))
    values = {**read, **given}
    return validate(TrainConfig, {**_published(values), **values}, "training")


def _published(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values that a network was published with."""
    return PUBLISHED.get(str(values.get("network", "dsm")), {})
