"""Which segments make a batch, how they are related, and batches made ahead of their use."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .config import TrainConfig
from .dataset import SegmentDataset
from .labels import groups_of
from .tasks import Batch, Task

_AHEAD = 3


def draw_batch(
    groups: list[NDArray[np.int64]],
    sessions: NDArray[np.int64],
    mistakable: NDArray[np.int64],
    config: TrainConfig,
    rng: np.random.Generator,
) -> tuple[NDArray[np.int64], int]:
    """Some views of some objects: random ones, and others that are easily taken for them.

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
    """Some views of an object; mostly of different sessions, as far as there are several."""
    order = rng.permutation(group)
    if rng.random() < config.across:
        _, first = np.unique(sessions[order], return_index=True)
        order = np.concatenate([order[np.sort(first)], np.delete(order, first)])
    return order[: config.views]


def relations(
    dataset: SegmentDataset, indices: NDArray[np.int64], far_m: float
) -> tuple[Tensor, Tensor]:
    """(B, B) which pairs show the same object, and which surely different ones.

    Pairs of one world with different labels that lie nearer than ``far_m`` are neither: they may be
    parts of one object.
    """
    labels = dataset.labels[indices]
    same = (labels[:, None] == labels[None, :]) & ~np.eye(len(indices), dtype=bool)
    different = dataset.different(indices[:, None], indices[None, :], far_m)
    return torch.from_numpy(same), torch.from_numpy(different)


class Batches:
    """The batches of a training run; that of a step depends on the step and the rank alone.

    Parameters
    ----------
    dataset : SegmentDataset
    task : Task
    rank : int
        Which of several processes this is: each draws its own batches.

    Attributes
    ----------
    groups : list of (n,) int64
        Segments of each object with at least two.
    mistakable : (n, m) int64
        Some objects, and after each those that are easily taken for it; may be empty.
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
        """The batch of a step."""
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
        """Batches of the steps from ``first`` to before ``last``, made ahead in other threads.

        ``mistakable`` must not be changed until they are used up.
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
