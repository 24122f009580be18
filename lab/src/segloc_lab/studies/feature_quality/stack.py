"""Many networks of one kind trained side by side as one batched computation (``torch.vmap``).

The networks of the paper are so small that a GPU waits for their kernels to be launched; a stack of
them costs little more than one. All of a seed begin alike and see the same random objects, so that
what they differ by is their loss.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.func import functional_call, stack_module_state, vmap

from ...training.models import LAYERS, DescriptorNetwork
from ...training.ops import torch_forms
from ...training.pair_heads import PairHead, pair_loss
from .batches import Batch, Objects
from .prepare import distances, neighbors, prepared

_CLIP, _WARMUP, _DECAY = 5.0, 100, 1e-5
_MINE_EVERY, _RIVALS = 150, 16
_PAIR_WEIGHT = 0.1
_VIEWS = 6


@dataclass(frozen=True)
class Variant:
    """One way of training.

    Attributes
    ----------
    name : str
    head : {"linear", "two_layer"} or None
        Trained with the descriptor; None: the descriptor alone.
    far : bool
        FC4 also learns from random pairs, beside those of the batch, half of which are mined.
    """

    name: str
    head: str | None
    far: bool = True


VARIANTS = (
    Variant("alone", None),
    Variant("joint-linear", "linear"),
    Variant("joint-two_layer", "two_layer"),
    Variant("joint-linear-mined", "linear", far=False),
)
"""The last is the form that was tried first, on the pairs of a batch alone."""


class Stack:
    """M networks: every variant for every seed, in that order of the first axis of everything.

    Parameters
    ----------
    network : {"dsm", "esm"}
    objects : Objects
        What they are trained on.
    seeds : sequence of int
    device : torch.device
    """

    def __init__(
        self, network: str, objects: Objects, seeds: Sequence[int], device: torch.device
    ) -> None:
        self.layers, self.objects, self.device = LAYERS[network], objects, device
        self.seeds = tuple(seeds)
        self.names = [(variant.name, seed) for variant in VARIANTS for seed in seeds]
        models, linear, deep = [], [], []
        for _, seed in self.names:
            torch.manual_seed(seed)
            models.append(DescriptorNetwork(self.layers).to(device))
            linear.append(PairHead("linear", models[-1].fc3.out_features).to(device))
            deep.append(PairHead("two_layer", models[-1].fc3.out_features).to(device))
        self._base = copy.deepcopy(models[0])
        self._heads = {"linear": copy.deepcopy(linear[0]), "two_layer": copy.deepcopy(deep[0])}
        self.params, self.buffers = stack_module_state(models)
        self.heads = {
            "linear": stack_module_state(linear)[0],
            "two_layer": stack_module_state(deep)[0],
        }
        self._weights = {
            (head, far): self._per_model(
                [_PAIR_WEIGHT * (v.head == head and v.far == far) for v in VARIANTS]
            )
            for head in self._heads
            for far in (True, False)
        }

    def _per_model(self, values: Sequence[float]) -> Tensor:
        return torch.tensor(values, device=self.device).repeat_interleave(len(self.seeds))

    def encode(self, points: Tensor, found: Sequence[Tensor], *, training: bool) -> Tensor:
        """Descriptors (M, B, dim) of segments that are given for each network, (M, B, 256, 3)."""
        self._base.train(training)

        def one(params: Any, buffers: Any, p: Tensor, *index: Tensor) -> Tensor:
            result: Tensor = functional_call(self._base, (params, buffers), (p, *index))
            return result

        with torch_forms():
            each: Tensor = vmap(one, randomness="error")(self.params, self.buffers, points, *found)
        return each

    def describe(self, points: Tensor, at_once: int = 64) -> Tensor:
        """Descriptors (M, P, dim) of prepared segments (P, 256, 3)."""
        M, parts = len(self.names), []
        with torch.no_grad():
            for some in points.split(at_once):
                near = [index.long() for index in neighbors(some, self.layers)]
                found = [index.expand(M, *index.shape) for index in near]
                parts.append(self.encode(some.expand(M, *some.shape), found, training=False))
        return torch.cat(parts, dim=1)

    def pair_logits(self, head: str, a: Tensor, b: Tensor) -> Tensor:
        """Of descriptors (M, ..., dim), by the heads that were trained beside the networks."""

        def one(params: Any, a: Tensor, b: Tensor) -> Tensor:
            result: Tensor = functional_call(self._heads[head], params, (a, b))
            return result

        each: Tensor = vmap(one)(self.heads[head], a, b)
        return each

    def loss(self, x: Tensor, batch: Batch) -> Tensor:
        """(M,) losses of descriptors (M, B, dim): InfoNCE, and FC4's where a variant has one."""
        total = _info_nce(x, batch.same, batch.different)
        for head in self._heads:
            logits = self.pair_logits(head, x[:, :, None], x[:, None])
            mined = vmap(pair_loss)(logits, batch.same, batch.different)
            both = vmap(pair_loss)(logits, batch.same, batch.different, batch.far)
            total = total + self._weights[head, True] * both + self._weights[head, False] * mined
        return total

    def train(self, steps: int, seconds: float, rate: float, say: Callable[[str], None]) -> int:
        """Train all networks; the learning rate ends when the steps or the time do."""
        start = time.monotonic()
        views = self._views()
        generator = torch.Generator(self.device).manual_seed(1)
        parameters = [*self.params.values(), *(t for h in self.heads.values() for t in h.values())]
        for tensor in parameters:
            tensor.requires_grad_(True)
        optimizer = torch.optim.Adam(parameters, lr=rate, weight_decay=_DECAY, foreach=True)
        torch.set_float32_matmul_precision("high")
        rivals: Tensor | None = None
        step = 0
        while True:
            done = max(step / steps, (time.monotonic() - start) / seconds)
            if done >= 1:
                break
            if step and step % _MINE_EVERY == 0:
                rivals = self._mine(views)
            batch = self.objects.draw(self.seeds, step, len(VARIANTS), rivals)
            shape = len(self.seeds), batch.indices.shape[1]
            view = torch.randint(_VIEWS, shape, generator=generator, device=self.device)
            view = view.repeat(len(VARIANTS), 1)
            points, *found = (table[view, batch.indices] for table in views)
            losses = self.loss(self.encode(points, [i.long() for i in found], training=True), batch)
            optimizer.param_groups[0]["lr"] = rate * _schedule(step, done)
            optimizer.zero_grad(set_to_none=True)
            losses.sum().backward()
            _clip(parameters)
            optimizer.step()
            step += 1
            if step % 250 == 0:
                mean = losses.detach().view(len(VARIANTS), -1).mean(dim=1)
                say(f"step {step} {time.monotonic() - start:.0f} s, losses {mean.tolist()}")
        torch.set_float32_matmul_precision("highest")
        for tensor in parameters:
            tensor.requires_grad_(False)
        return step

    def _views(self) -> list[Tensor]:
        """Changed segments and their neighbours, made once: (views, P, ...) each."""
        generator = torch.Generator(self.device).manual_seed(0)
        tables: list[list[Tensor]] = []
        for _ in range(_VIEWS):
            points = prepared(self.objects.points, self.objects.sizes, generator)
            tables.append([points, *neighbors(points, self.layers)])
        return [torch.stack(each) for each in zip(*tables, strict=True)]

    def _mine(self, views: Sequence[Tensor]) -> Tensor:
        """(M, G, 16): for every object those whose descriptors are nearest to its own."""
        vectors = self.describe(views[0][0, self.objects.first_views()])
        near: Tensor = distances(vectors, vectors).topk(_RIVALS + 1, largest=False).indices
        return near[..., 1:]

    def state(self, number: int) -> dict[str, Tensor]:
        """The tensors of one network and its heads."""
        tables = {"": {**self.params, **self.buffers}} | {f"{k}.": v for k, v in self.heads.items()}
        return {
            f"{prefix}{name}": tensor[number].detach().cpu()
            for prefix, table in tables.items()
            for name, tensor in table.items()
        }


def _info_nce(x: Tensor, same: Tensor, different: Tensor) -> Tensor:
    """:func:`segloc_lab.training.losses.info_nce` of each of M batches, (M,)."""
    logits = -(x[:, :, None] - x[:, None]).square().sum(dim=-1)
    others = torch.logsumexp(logits.masked_fill(~different, -1e9), dim=2, keepdim=True)
    losses = (torch.logaddexp(logits, others) - logits).masked_fill(~same, 0.0)
    return losses.sum(dim=(1, 2)) / same.sum(dim=(1, 2)).clamp(min=1)


def _clip(parameters: Sequence[Tensor]) -> None:
    """Shorten the gradient of each network by itself to a norm of 5."""
    gradients = [p.grad for p in parameters if p.grad is not None]
    norm = torch.stack([g.flatten(1).square().sum(dim=1) for g in gradients]).sum(dim=0).sqrt()
    scale = (_CLIP / (norm + 1e-6)).clamp(max=1.0)
    for gradient in gradients:
        gradient.mul_(scale.view(-1, *[1] * (gradient.dim() - 1)))


def _schedule(step: int, done: float) -> float:
    """Linear warm-up, then half a cosine down to 1 %."""
    return min(1.0, (step + 1) / _WARMUP) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * done)))
