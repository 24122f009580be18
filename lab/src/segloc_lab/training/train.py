"""Train a descriptor network on labelled segments, and export it."""

from __future__ import annotations

import copy
import hashlib
import math
import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import torch
import torch.distributed as dist
from numpy.typing import NDArray
from pydantic import ValidationError
from torch import Tensor, nn

from segloc.errors import ConfigError, DatasetError
from segloc.system import kernels
from segloc.system.files import replacing

from .config import TrainConfig
from .dataset import SegmentDataset
from .labels import groups_of
from .metrics import Scores, score
from .tasks import Batch, Task, create_task

_AHEAD = 3


def draw_batch(
    groups: list[NDArray[np.int64]],
    sessions: NDArray[np.int64],
    mistakable: NDArray[np.int64],
    config: TrainConfig,
    rng: np.random.Generator,
) -> tuple[NDArray[np.int64], int]:
    """Draw views of random objects, and of hard ones similar to them.

    The second number is how many of them, from the first on, are of the random ones.
    """
    hard = round(config.hard_share * config.classes) if len(mistakable) else 0
    count = config.classes - hard
    rivals: list[int] = []
    if not hard:
        chosen = list(rng.choice(len(groups), size=min(len(groups), count), replace=False))
    else:
        rows = rng.choice(len(mistakable), size=min(len(mistakable), count), replace=False)
        chosen = list(mistakable[rows, 0])
        near = mistakable[rng.choice(rows, size=4 * hard), 1:]
        picked = near[np.arange(len(near)), rng.integers(near.shape[1], size=len(near))]
        rivals = list(dict.fromkeys(picked[~np.isin(picked, chosen)]))[:hard]
    parts = [_views(groups[g], sessions, config, rng) for g in [*chosen, *rivals]]
    return np.concatenate(parts), sum(map(len, parts[: len(chosen)]))


def _views(
    group: NDArray[np.int64],
    sessions: NDArray[np.int64],
    config: TrainConfig,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Draw some views of an object; mostly of different sessions, if there are several."""
    order = rng.permutation(group)
    if rng.random() < config.across:
        _, first = np.unique(sessions[order], return_index=True)
        order = np.concatenate([order[np.sort(first)], np.delete(order, first)])
    return order[: config.views]


def relations(
    dataset: SegmentDataset, indices: NDArray[np.int64], far_m: float
) -> tuple[Tensor, Tensor]:
    """Return which pairs show the same object, and which certainly different ones, (B, B).

    Pairs of one world with different labels closer than ``far_m`` are neither: they may be parts of
    one object.
    """
    labels = dataset.labels[indices]
    same = (labels[:, None] == labels[None, :]) & ~np.eye(len(indices), dtype=bool)
    different = dataset.different(indices[:, None], indices[None, :], far_m)
    return torch.from_numpy(same), torch.from_numpy(different)


class Batches:
    """Batches of a training run; each depends on the step and the rank alone.

    Parameters
    ----------
    rank : int
        Number of this process; each draws its own batches.

    Attributes
    ----------
    groups : list of (n,) int64
        Segments of each object with at least two.
    mistakable : (n, m) int64
        Some objects, and after each those similar to it; may be empty.
    """

    def __init__(self, dataset: SegmentDataset, task: Task, rank: int = 0) -> None:
        self._dataset, self._task, self._rank = dataset, task, rank
        self.groups = [group for group in groups_of(dataset.labels) if len(group) > 1]
        if task.max_objects is not None and len(self.groups) > task.max_objects:
            self.groups = sorted(self.groups, key=len, reverse=True)[: task.max_objects]
        self.mistakable: NDArray[np.int64] = np.empty((0, 0), np.int64)
        self._numbers = np.full(int(dataset.labels.max(initial=0)) + 1, -1, np.int64)
        for number, group in enumerate(self.groups):
            self._numbers[dataset.labels[group[0]]] = number

    def make(self, step: int) -> Batch:
        """Return the batch of a step."""
        config = self._task.config
        seed = [config.seed, step, self._rank] if self._rank else [config.seed, step]
        rng = np.random.default_rng(seed)
        indices, random = draw_batch(
            self.groups, self._dataset.sessions, self.mistakable, config, rng
        )
        inputs = self._task.inputs(self._dataset, indices, rng)
        labels = torch.from_numpy(self._numbers[self._dataset.labels[indices]])
        related = relations(self._dataset, indices, config.different_m)
        return Batch(inputs, labels, *related, torch.arange(len(indices)) < random)

    def between(self, first: int, last: int) -> Iterator[Batch]:
        """Yield batches of the steps from ``first`` to before ``last``, prepared in other threads.

        ``mistakable`` must not change meanwhile.
        """
        with ThreadPoolExecutor(self._task.config.threads) as pool:
            waiting: deque[Future[Batch]] = deque()
            try:
                for step in range(first, last):
                    waiting.append(pool.submit(self.make, step))
                    if len(waiting) > _AHEAD:
                        yield waiting.popleft().result()
                while waiting:
                    yield waiting.popleft().result()
            finally:
                for future in waiting:
                    future.cancel()


Progress = Callable[[str], None]
_MAY_CHANGE = {"steps", "max_minutes", "threads", "device"}
_RIVALS = 16
_LARGEST = 1e15  # limit of the neighbour search
_UNREADABLE = (OSError, EOFError, RuntimeError, KeyError, TypeError, ValueError, UnpicklingError)


def train(
    dataset: SegmentDataset,
    out: Path,
    config: TrainConfig,
    card: dict[str, Any] | None = None,
    progress: Progress = print,
) -> Scores:
    """Train a network, and write ``out`` (a .safetensors file) with the best weights.

    The state is saved in ``out`` with the suffix .checkpoint: an interrupted run with the same
    configuration resumes from it. Under torchrun several processes train together, each on its own
    batches.

    Parameters
    ----------
    dataset : SegmentDataset
        Split by worlds (or by objects, if there is one world) into training and validation.
    card : dict, optional
        Stored in the weights file: data, command, licence. Figures are added.

    Returns
    -------
    Scores
        Of the exported weights on the validation set.
    """
    torch.set_num_threads(config.threads)
    task = create_task(config)
    training, held = dataset.split(config.validation_share, config.seed)
    validation = held.limited(config.validation_limit, config.seed)
    with Group(config.device) as group:
        run = _Run(task, training, validation, group, out.with_suffix(".checkpoint"))
        run.resume(progress)
        run.loop(progress if group.leads else lambda _: None)
        if group.leads:
            model = run.best_model()
            task.finish(model, training, held)
            figures = {
                "steps": run.best_step,
                "training segments": len(training),
                "validation segments": len(validation),
                **{f"validation {k}": v and round(v, 4) for k, v in asdict(run.best).items()},
            }
            settings = config.model_dump(mode="json", exclude={"max_minutes", "threads"})
            made = {"torch": torch.__version__, "figures": figures, "config": settings}
            task.export(model, out, {**(card or {}), **made})
    return run.best


class _Run:
    """State of a training run."""

    def __init__(
        self,
        task: Task,
        training: SegmentDataset,
        validation: SegmentDataset,
        group: Group,
        checkpoint: Path,
    ) -> None:
        self.task, self.config, self.group = task, task.config, group
        self.training, self.validation, self.checkpoint = training, validation, checkpoint
        self.batches = Batches(training, task, group.rank)
        objects = len(self.batches.groups)
        if objects < self.config.classes:
            raise DatasetError(
                f"training needs {self.config.classes} objects with two views, not {objects}"
            )
        torch.manual_seed(self.config.seed)
        self.model = task.network(objects).to(group.device)
        self.optimizer = torch.optim.Adam(
            self.model.parameters(),
            lr=self.config.learning_rate,
            weight_decay=self.config.weight_decay,
            foreach=True,
        )
        self.step, self.seconds = 0, 0.0
        self.best, self.best_step = Scores(0.0, -1.0, 0.0), 0
        self.best_state: dict[str, Tensor] = {}

    @cached_property
    def _dataset_digest(self) -> str:
        """Digest of what is trained and validated on."""
        return hashlib.sha256(
            b"".join(part.digest() for part in (self.training, self.validation))
        ).hexdigest()

    @property
    def _waited(self) -> float:
        """Number of validations without improvement."""
        return (self.step - self.best_step) / self.config.validate_every

    def loop(self, progress: Progress) -> None:
        config = self.config
        if self._waited >= config.patience or self.seconds > 60 * config.max_minutes:
            return  # ended before
        start = time.monotonic() - self.seconds
        losses: list[Tensor] = []
        for batch in self._upcoming():
            losses.append(self._advance(batch))
            self.seconds = time.monotonic() - start
            expired = self.group.agreed(self.seconds > 60 * config.max_minutes)
            if self.step % config.validate_every == 0 or self.step == config.steps or expired:
                scores = self._validate()
                loss = float(torch.stack(losses).mean())
                progress(
                    f"step {self.step} loss {loss:.3f} validation {scores}, "
                    f"{self.seconds / 60:.1f} min"
                )
                losses = []
                if self.group.agreed(expired or self._waited >= config.patience):
                    return

    def _upcoming(self) -> Iterator[Batch]:
        """Yield the remaining batches; a search for hard objects precedes its batches."""
        config = self.config
        every = config.mine_every if config.hard_share > 0 else config.steps
        while self.step < config.steps:
            if self.step > 0 and self.step % every == 0:
                self.batches.mistakable = self._mine()
            yield from self.batches.between(
                self.step, min(config.steps, (self.step // every + 1) * every)
            )

    def _advance(self, batch: Batch) -> Tensor:
        config = self.config
        for group in self.optimizer.param_groups:
            group["lr"] = config.learning_rate * _schedule(self.step, config)
        self.model.train()
        with self._precision():
            loss = self.task.loss(self.model, batch.to(self.group.device))
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self.group.average_gradients(self.model)
        nn.utils.clip_grad_norm_(self.model.parameters(), config.clip)
        self.optimizer.step()
        self.step += 1
        return loss.detach()

    def _precision(self) -> AbstractContextManager[Any]:
        """Return autocast; bfloat16 has the range of single precision, so no loss is scaled."""
        kind, precision = self.group.device.type, self.config.precision
        if precision == "bfloat16" or (precision == "auto" and kind == "cuda"):
            return torch.autocast(kind, dtype=torch.bfloat16)
        return nullcontext()

    def _mine(self) -> NDArray[np.int64]:
        """Return some objects, each with those of the nearest descriptors, (n, 17)."""
        groups = self.batches.groups
        rng = np.random.default_rng([self.config.seed, self.step, 1])
        some = rng.permutation(len(groups))[: self.config.mine_objects]
        views = np.array([groups[g][0] for g in some])
        vectors = self._describe(self.model, self.training.subset(views))
        indices, _ = kernels.knn(vectors, vectors, _RIVALS + 1, self.config.threads)
        return np.column_stack([some, some[indices[:, 1:]]])

    def _describe(self, model: nn.Module, dataset: SegmentDataset) -> NDArray[np.float32]:
        fault = ConfigError(
            f"descriptors are not finite at step {self.step}; try a smaller learning_rate"
        )
        try:
            vectors = self.task.describe(self._on_cpu(model), dataset)
        except ValueError as error:  # rejected by the native network
            raise fault from error
        if not (np.abs(vectors) < _LARGEST).all():
            raise fault
        return vectors

    def _on_cpu(self, model: nn.Module) -> nn.Module:
        return model if self.group.device.type == "cpu" else copy.deepcopy(model).cpu()

    def _validate(self) -> Scores:
        self.group.average_buffers(self.model)
        vectors = self._describe(self.model, self.validation)
        scores = score(vectors, self.validation, threads=self.config.threads)
        if (scores.recall or 0.0) + scores.auc > (self.best.recall or 0.0) + self.best.auc:
            self.best, self.best_step = scores, self.step
            self.best_state = {k: v.clone() for k, v in self.model.state_dict().items()}
        if self.group.leads:
            self._save()
        return scores

    def best_model(self) -> nn.Module:
        """Return the network with the best weights, on the CPU, in evaluation mode."""
        model = self.task.network(len(self.batches.groups))
        model.load_state_dict({k: v.cpu() for k, v in self.best_state.items()})
        return model.eval()

    def _save(self) -> None:
        state = {
            "config": self.config.model_dump_json(exclude=_MAY_CHANGE),
            "dataset": self._dataset_digest,
            "model": self.model.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "seconds": self.seconds,
            "best": asdict(self.best),
            "best_step": self.best_step,
            "best_state": self.best_state,
            "mistakable": torch.from_numpy(self.batches.mistakable),
        }
        self.checkpoint.parent.mkdir(parents=True, exist_ok=True)
        with replacing(self.checkpoint) as stream:
            torch.save(state, stream)

    def resume(self, progress: Progress) -> None:
        """Resume an interrupted run, if there is one."""
        if not self.checkpoint.exists():
            return
        try:
            state = torch.load(self.checkpoint, weights_only=True, map_location=self.group.device)
            for same, what in (
                (_agrees(state["config"], self.config), "with another configuration"),
                (state["dataset"] == self._dataset_digest, "on another dataset"),
            ):
                if not same:
                    remedy = "remove it to restart, or choose another --out"
                    raise DatasetError(f"{self.checkpoint}: of a run {what}: {remedy}")
            self.model.load_state_dict(state["model"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.step, self.seconds = state["step"], state["seconds"]
            self.best, self.best_step = Scores(**state["best"]), state["best_step"]
            self.best_state = state["best_state"]
            self.batches.mistakable = state["mistakable"].cpu().numpy()
        except _UNREADABLE as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0].rstrip(":")
            raise DatasetError(
                f"{self.checkpoint}: not the state of this run ({reason}); remove it to restart"
            ) from error
        progress(f"resuming from step {self.step}")


def _agrees(saved: str, config: TrainConfig) -> bool:
    """Return whether a run with the saved configuration may resume; missing keys have defaults."""
    try:
        before = TrainConfig.model_validate_json(saved)
    except ValidationError:
        return False
    return before.model_dump(exclude=_MAY_CHANGE) == config.model_dump(exclude=_MAY_CHANGE)


def _schedule(step: int, config: TrainConfig) -> float:
    """Linear warm-up, then half a cosine down to 1 %."""
    if step < config.warmup:
        return (step + 1) / config.warmup
    done = (step - config.warmup) / max(1, config.steps - config.warmup)
    return 0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * min(1.0, done)))


class Group:
    """The processes of a run; on entry they are connected if there are several.

    Attributes
    ----------
    leads : bool
        True for the process that validates and writes files.
    """

    def __init__(self, device: str) -> None:
        if device == "cuda" and not torch.cuda.is_available():
            raise ConfigError("there is no CUDA device; use --device cpu")
        self.rank = int(os.environ.get("RANK", 0))
        self._size = int(os.environ.get("WORLD_SIZE", 1))
        local = int(os.environ.get("LOCAL_RANK", 0))
        self.device = torch.device("cuda", local) if device == "cuda" else torch.device("cpu")
        self.leads = self.rank == 0

    def __enter__(self) -> Group:
        if self._size > 1:
            dist.init_process_group("nccl" if self.device.type == "cuda" else "gloo")
        return self

    def __exit__(self, *_: object) -> None:
        if self._size > 1:
            dist.destroy_process_group()

    def average_gradients(self, model: nn.Module) -> None:
        """Average the gradients of all processes in one exchange.

        The networks are small, and a task may call any part of one, which a wrapper around
        ``forward`` would miss.
        """
        if self._size > 1:
            parameters = list(model.parameters())
            self._average([torch.zeros_like(p) if p.grad is None else p.grad for p in parameters])

    def average_buffers(self, model: nn.Module) -> None:
        """Average the running statistics of all processes."""
        if self._size > 1:
            self._average([b for b in model.buffers() if b.is_floating_point()])

    def _average(self, tensors: list[Tensor]) -> None:
        flat = torch.cat([tensor.flatten() for tensor in tensors])
        dist.all_reduce(flat)
        parts = (flat / self._size).split([tensor.numel() for tensor in tensors])
        for tensor, mean in zip(tensors, parts, strict=True):
            tensor.copy_(mean.view_as(tensor))

    def agreed(self, wanted: bool) -> bool:
        """Return the leading process's value, so that all stop at the same step."""
        if self._size == 1:
            return wanted
        flag = torch.tensor([float(wanted)], device=self.device)
        dist.broadcast(flag, src=0)
        return bool(flag.item())
