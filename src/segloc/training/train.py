"""Train a descriptor network on labelled segments, and export it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .. import _native
from ..errors import DatasetError
from .batches import draw_batch, groups_of, limited, prepared_batch, relations
from .config import TrainConfig
from .dataset import SegmentDataset
from .export import export
from .losses import hard_triplet, info_nce, pair_match
from .metrics import Scores, score
from .models import LAYERS, DescriptorNetwork
from .quality import describe, fit_quality

Progress = Callable[[str], None]


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
    run = _Run(training, limited(validation, config), config, out.with_suffix(".checkpoint"))
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
        self.groups = groups_of(training)
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
        losses: list[float] = []
        while self.step < config.steps:
            losses.append(self._advance())
            self.seconds = time.monotonic() - start
            expired = self.seconds > 60 * config.max_minutes
            if self.step % config.validate_every == 0 or self.step == config.steps or expired:
                scores = self._validate()
                progress(
                    f"step {self.step} loss {np.mean(losses):.3f} {_text(scores)} "
                    f"{self.seconds / 60:.1f} min"
                )
                losses = []
                waited = (self.step - self.best_step) / config.validate_every
                if expired or waited >= config.patience:
                    return

    def _advance(self) -> float:
        config = self.config
        rng = np.random.default_rng([config.seed, self.step])
        if config.hard_share > 0 and self.step > 0 and self.step % config.mine_every == 0:
            self.mistakable = self._mine()
        indices = draw_batch(self.groups, self.mistakable, config, rng)
        points = torch.from_numpy(prepared_batch(self.training, indices, config, rng))
        same, different = relations(self.training, indices, config.different_m)
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

    def _validate(self) -> Scores:
        vectors = describe(self.model, self.validation, self.config)
        scores = score(vectors, self.validation, threads=self.config.threads)
        if scores.recall + scores.auc > self.best.recall + self.best.auc:
            self.best, self.best_step = scores, self.step
            self.best_state = {k: v.clone() for k, v in self.model.state_dict().items()}
        self._save()
        return scores

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
