"""Train a descriptor network on labelled segments, and export it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.nn import functional

from .. import _native
from ..descriptors.pointset import POINTS, Alignment
from ..errors import DatasetError
from ..types import Float32
from .augment import AugmentConfig, augment
from .dataset import SegmentDataset
from .export import export, folded
from .losses import hard_triplet, info_nce, pair_match
from .metrics import Scores, nearest_is_right, score
from .models import LAYERS, DescriptorNetwork
from .sampling import Sampler, reorder

Progress = Callable[[str], None]


class TrainConfig(BaseModel):
    """Everything that decides how a network comes out."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    network: Literal["dsm", "esm"] = "dsm"
    alignment: Alignment = "pca2d"
    sampler: Sampler = "farthest"
    loss: Literal["info_nce", "triplet"] = "info_nce"
    pair_weight: float = Field(0.1, ge=0, description="weight of FC4's loss")
    steps: int = Field(3000, ge=1)
    classes: int = Field(32, ge=2, description="objects a batch")
    views: int = Field(2, ge=2, description="segments of each object a batch")
    hard_share: float = Field(0.5, ge=0, le=1, description="objects chosen to be mistakable")
    mine_every: int = Field(500, ge=1, description="steps between searches for such objects")
    learning_rate: float = Field(2e-3, gt=0)
    warmup: int = Field(100, ge=0, description="steps until the full learning rate")
    weight_decay: float = Field(1e-5, ge=0)
    clip: float = Field(5.0, gt=0, description="largest norm of the gradient")
    augmentation: AugmentConfig = AugmentConfig()
    validation_share: float = Field(0.15, gt=0, lt=1)
    validation_limit: int = Field(3000, ge=1, description="segments that validation looks at")
    validate_every: int = Field(250, ge=1)
    patience: int = Field(8, ge=1, description="validations without a better one until the end")
    max_minutes: float = Field(math.inf, gt=0)
    threads: int = Field(1, ge=1)
    seed: int = 0


def train(
    dataset: SegmentDataset,
    out: Path,
    config: TrainConfig,
    card: dict[str, Any] | None = None,
    progress: Progress = print,
) -> Scores:
    """Train a network, and write ``out`` (a .safetensors file) with the best weights.

    The state is kept in ``out`` with the suffix .checkpoint: a run that was cut off goes on from
    there if it is started again with the same configuration.

    Parameters
    ----------
    dataset : SegmentDataset
        Split by worlds (or by objects, if there is one world) into training and validation.
    out : Path
    config : TrainConfig
    card : dict, optional
        Goes into the weights file: data, command, licence. Figures are added.
    progress : callable

    Returns
    -------
    Scores
        Of the exported weights on the validation set.

    Raises
    ------
    DatasetError
        If there are too few objects with two views.
    """
    torch.set_num_threads(config.threads)
    training, validation = dataset.split(config.validation_share, config.seed)
    run = _Run(training, _limited(validation, config), config, out.with_suffix(".checkpoint"))
    run.resume(progress)
    run.loop(progress)
    model = run.best_model()
    fit_quality(model, training, config)
    figures = {
        "steps": run.best_step,
        "training segments": len(training),
        "validation segments": len(run.validation),
        **{f"validation {name}": round(value, 4) for name, value in asdict(run.best).items()},
    }
    settings = config.model_dump(mode="json")
    export(model, out, {**(card or {}), "figures": figures, "config": settings}, config.alignment)
    return run.best


class _Run:
    """The state of one training run."""

    def __init__(
        self,
        training: SegmentDataset,
        validation: SegmentDataset,
        config: TrainConfig,
        checkpoint: Path,
    ) -> None:
        self.training, self.validation, self.config = training, validation, config
        self.checkpoint = checkpoint
        self.groups = _groups(training)
        if len(self.groups) < config.classes:
            raise DatasetError(
                f"training needs {config.classes} objects with two views, not {len(self.groups)}"
            )
        torch.manual_seed(config.seed)
        self.model = DescriptorNetwork(LAYERS[config.network])
        self.optimizer = torch.optim.Adam(
            self.model.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
        )
        self.step = 0
        self.seconds = 0.0
        self.best = Scores(0.0, -1.0, 0.0)
        self.best_step = 0
        self.best_state: dict[str, Tensor] = {}
        self.mistakable = np.empty((0, 0), np.int64)

    def loop(self, progress: Progress) -> None:
        config = self.config
        start = time.monotonic() - self.seconds
        last = self.step
        losses: list[float] = []
        while self.step < config.steps:
            losses.append(self._advance())
            self.seconds = time.monotonic() - start
            expired = self.seconds > 60 * config.max_minutes
            if self.step % config.validate_every == 0 or self.step == config.steps or expired:
                self._validate()
                rate = (self.step - last) / max(len(losses), 1)
                progress(
                    f"step {self.step} loss {np.mean(losses):.3f} {_text(self.validation_scores)} "
                    f"{self.seconds / 60 * rate:.1f} min"
                )
                losses, last = [], self.step
                waited = (self.step - self.best_step) / config.validate_every
                if expired or waited >= config.patience:
                    return

    def _advance(self) -> float:
        config = self.config
        rng = np.random.default_rng([config.seed, self.step])
        if config.hard_share > 0 and self.step > 0 and self.step % config.mine_every == 0:
            self.mistakable = self._mine()
        indices = _batch(self.groups, self.mistakable, config, rng)
        points = torch.from_numpy(prepared_batch(self.training, indices, config, rng))
        same, different = _relations(self.training, indices)
        for group in self.optimizer.param_groups:
            group["lr"] = config.learning_rate * _schedule(self.step, config)
        self.model.train()
        x = self.model(points)
        loss_of = info_nce if config.loss == "info_nce" else hard_triplet
        loss = loss_of(x, same, different)
        pairs = self.model.pair_logits(x[:, None], x[None, :])
        loss = loss + config.pair_weight * pair_match(pairs, same, different)
        self.optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), config.clip)
        self.optimizer.step()
        self.step += 1
        return float(loss.detach())

    def _mine(self) -> NDArray[np.int64]:
        """The objects whose descriptors are nearest to those of each object, (objects, 16)."""
        first = np.array([group[0] for group in self.groups])
        vectors = describe(self.model, self.training.subset(first), self.config)
        indices, _ = _native.knn(vectors, vectors, 17, self.config.threads)
        return indices[:, 1:]

    def _validate(self) -> None:
        vectors = describe(self.model, self.validation, self.config)
        scores = score(vectors, self.validation, threads=self.config.threads)
        self.validation_scores = scores
        if scores.recall + scores.auc > self.best.recall + self.best.auc:
            self.best, self.best_step = scores, self.step
            self.best_state = {k: v.clone() for k, v in self.model.state_dict().items()}
        self._save()

    def best_model(self) -> DescriptorNetwork:
        model = DescriptorNetwork(LAYERS[self.config.network])
        model.load_state_dict(self.best_state)
        return model.eval()

    def _save(self) -> None:
        state = {
            "config": self.config.model_dump_json(exclude={"steps", "max_minutes", "threads"}),
            "model": self.model.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "seconds": self.seconds,
            "best": asdict(self.best),
            "best_step": self.best_step,
            "best_state": self.best_state,
            "mistakable": torch.from_numpy(self.mistakable),
        }
        self.checkpoint.parent.mkdir(parents=True, exist_ok=True)
        partial = self.checkpoint.with_suffix(".partial")
        torch.save(state, partial)
        partial.replace(self.checkpoint)

    def resume(self, progress: Progress) -> None:
        if not self.checkpoint.exists():
            return
        state = torch.load(self.checkpoint, weights_only=True)
        if state["config"] != self.config.model_dump_json(
            exclude={"steps", "max_minutes", "threads"}
        ):
            raise DatasetError(f"{self.checkpoint}: belongs to a run with another configuration")
        self.model.load_state_dict(state["model"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.seconds = state["step"], state["seconds"]
        self.best, self.best_step = Scores(**state["best"]), state["best_step"]
        self.best_state = state["best_state"]
        self.mistakable = state["mistakable"].numpy()
        progress(f"going on from step {self.step}")


def _text(scores: Scores) -> str:
    return (
        f"validation auc {scores.auc:.4f} recall@25 {scores.recall:.4f} "
        f"recall@1 {scores.recall_first:.4f}"
    )


def _schedule(step: int, config: TrainConfig) -> float:
    """Linear warm-up, then half a cosine down to 1 %."""
    if step < config.warmup:
        return (step + 1) / config.warmup
    done = (step - config.warmup) / max(1, config.steps - config.warmup)
    return 0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * min(1.0, done)))


def _groups(dataset: SegmentDataset) -> list[NDArray[np.int64]]:
    """Indices of the segments of each object with at least two."""
    order = np.argsort(dataset.labels, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(dataset.labels[order])) + 1)
    return [group for group in groups if len(group) > 1]


def _batch(
    groups: list[NDArray[np.int64]],
    mistakable: NDArray[np.int64],
    config: TrainConfig,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Some views of some objects: random ones, and others that are easily taken for them."""
    order = rng.permutation(len(groups))
    hard = round(config.hard_share * config.classes) if len(mistakable) else 0
    chosen = list(order[: config.classes - hard])
    if hard:
        rivals = mistakable[rng.choice(chosen, size=4 * hard)]
        picked = rivals[np.arange(len(rivals)), rng.integers(rivals.shape[1], size=len(rivals))]
        chosen += list(dict.fromkeys(picked[~np.isin(picked, chosen)]))[:hard]
    views = [
        rng.choice(groups[g], size=min(config.views, len(groups[g])), replace=False) for g in chosen
    ]
    return np.concatenate(views)


def _relations(dataset: SegmentDataset, indices: NDArray[np.int64]) -> tuple[Tensor, Tensor]:
    labels = dataset.labels[indices]
    same = (labels[:, None] == labels[None, :]) & ~np.eye(len(indices), dtype=bool)
    different = dataset.different(indices[:, None], indices[None, :])
    return torch.from_numpy(same), torch.from_numpy(different)


def prepared_batch(
    dataset: SegmentDataset,
    indices: NDArray[np.int64],
    config: TrainConfig,
    rng: np.random.Generator | None = None,
) -> Float32:
    """Segments as the network reads them, (B, 256, 3); augmented where a generator is given."""
    parts = [dataset.segment(int(i)) for i in indices]
    if rng is not None:
        parts = [augment(part, config.augmentation, rng) for part in parts]
    offsets = np.cumsum([0, *(len(part) for part in parts)], dtype=np.int64)
    prepared = _native.prepare_segments(
        np.concatenate(parts), offsets, POINTS, config.alignment, config.threads
    )
    return reorder(prepared, config.sampler, rng or np.random.default_rng(config.seed))


def describe(model: DescriptorNetwork, dataset: SegmentDataset, config: TrainConfig) -> Float32:
    """Descriptors (P, dim) of all segments of a dataset, by the native network."""
    table = [(x.points, x.neighbors, x.dilation, x.channels) for x in model.layers]
    network = _native.Network(table, folded(model), POINTS)
    parts = [np.empty((0, network.dim), np.float32)]
    for first in range(0, len(dataset), 1024):
        indices = np.arange(first, min(first + 1024, len(dataset)))
        prepared = prepared_batch(dataset, indices, config)
        parts.append(network.describe(prepared, config.threads)[0])
    return np.concatenate(parts)


def fit_quality(model: DescriptorNetwork, dataset: SegmentDataset, config: TrainConfig) -> None:
    """Fit the quality head to how often the nearest descriptor is right.

    A logistic regression on the finished descriptors of up to ``validation_limit`` training
    segments, against the nearest descriptor of the other sessions: what a map would offer.
    """
    part = _limited(dataset, config)
    vectors = describe(model, part, config)
    right = nearest_is_right(vectors, part, config.threads)
    known = ~np.isnan(right)
    x, y = torch.from_numpy(vectors[known]), torch.from_numpy(right[known])
    head = model.quality_head
    torch.nn.init.zeros_(head.weight)
    torch.nn.init.zeros_(head.bias)
    if len(y) == 0:
        return
    optimizer = torch.optim.LBFGS(head.parameters(), max_iter=100, line_search_fn="strong_wolfe")

    def closure() -> Tensor:
        optimizer.zero_grad()
        loss = functional.binary_cross_entropy_with_logits(head(x).squeeze(-1), y)
        loss = loss + 1e-3 * head.weight.square().sum()
        loss.backward()
        return loss

    optimizer.step(closure)


def _limited(dataset: SegmentDataset, config: TrainConfig) -> SegmentDataset:
    """At most `validation_limit` segments: whole objects, so that matches stay together."""
    if len(dataset) <= config.validation_limit:
        return dataset
    rng = np.random.default_rng(config.seed)
    names = rng.permutation(np.unique(dataset.labels))
    rank = np.empty(int(names.max()) + 1, np.int64)
    rank[names] = np.arange(len(names))
    order = np.argsort(rank[dataset.labels], kind="stable")[: config.validation_limit]
    return dataset.subset(np.sort(order))
