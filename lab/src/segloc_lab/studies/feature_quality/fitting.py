"""FC4 fitted to finished descriptors: its kinds, on pairs of several origins."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.func import functional_call, stack_module_state, vmap

from ...training.config import HeadKind
from ...training.pair_fitting import random_pairs
from ...training.pair_heads import PairHead, pair_loss
from .compact import FAR_M, Segments
from .prepare import distances

_NEAREST = 5
_RATE, _DECAY = 0.02, 1e-5
KINDS: tuple[HeadKind, ...] = ("linear", "quadratic", "two_layer")


@dataclass(frozen=True)
class Effort:
    """How many pairs of each kind heads are fitted to, and for how many steps."""

    pairs: int = 8000
    steps: int = 400


@dataclass(frozen=True)
class Pairs:
    """N pairs of segments, of three kinds.

    Attributes
    ----------
    first, second : (M, N) int64
        For each of M networks.
    kind : (N,) int64
        0: of one object; 1: random ones, far apart; 2: nearest descriptors that are wrong.
    """

    first: Tensor
    second: Tensor
    kind: Tensor


def draw_pairs(segments: Segments, vectors: Tensor, count: int, seed: int = 0) -> Pairs:
    """Up to so many pairs of each kind; the nearest ones by each network's own vectors.

    Parameters
    ----------
    segments : Segments
        P of them.
    vectors : (M, P, dim)
    count : int
    seed : int
    """
    rng = np.random.default_rng(seed)
    device = vectors.device
    drawn = random_pairs(segments, count, rng)
    fixed = torch.from_numpy(np.stack([drawn.first, drawn.second], axis=1)).to(device)
    queries = torch.from_numpy(rng.integers(len(segments), size=count)).to(device)
    wrong = _different_from(segments, queries)
    hard = []
    for own in vectors:
        apart = distances(own[queries], own).masked_fill(~wrong, torch.inf)
        near = apart.topk(_NEAREST, largest=False).indices
        rank = torch.arange(count, device=device) % _NEAREST
        hard.append(torch.stack([queries, near.gather(1, rank[:, None])[:, 0]], dim=1))
    pairs = torch.cat([fixed.expand(len(vectors), -1, -1), torch.stack(hard)], dim=1)
    kind = np.concatenate([np.where(drawn.same, 0, 1), np.full(count, 2)])
    return Pairs(pairs[..., 0], pairs[..., 1], torch.from_numpy(kind).to(device))


def _different_from(segments: Segments, queries: Tensor) -> Tensor:
    """(Q, P) whether segments surely show other objects than some of them."""
    labels, places, at = (
        torch.from_numpy(column).to(queries.device)
        for column in (segments.labels, segments.places, segments.centroids)
    )
    apart = distances(at[queries], at) > FAR_M
    return (labels[queries][:, None] != labels) & (apart | (places[queries][:, None] != places))


def fitted(
    vectors: Tensor, pairs: Pairs, nearest: bool, kind: HeadKind, steps: int
) -> dict[str, Tensor]:
    """The parameters of M heads, each fitted to the descriptors (M, R, dim) of its network.

    ``nearest``: they also learn from nearest descriptors that are wrong, half of the negatives.
    """
    heads = []
    for number in range(len(vectors)):
        torch.manual_seed(number)
        heads.append(PairHead(kind, vectors.shape[-1]).to(vectors.device))
    base, params = heads[0], stack_module_state(heads)[0]
    each = torch.arange(len(vectors), device=vectors.device)[:, None]
    a, b = vectors[each, pairs.first], vectors[each, pairs.second]
    kinds = [pairs.kind == 1, pairs.kind == 2] if nearest else [pairs.kind == 1]
    optimizer = torch.optim.Adam(list(params.values()), lr=_RATE, weight_decay=_DECAY)

    def loss(own: dict[str, Tensor], a: Tensor, b: Tensor) -> Tensor:
        return pair_loss(functional_call(base, own, (a, b)), pairs.kind == 0, *kinds)

    for step in range(steps):
        optimizer.param_groups[0]["lr"] = _RATE * (1 - step / steps)
        optimizer.zero_grad()
        vmap(loss)(params, a, b).sum().backward()
        optimizer.step()
    return {name: tensor.detach() for name, tensor in params.items()}


def logits(kind: HeadKind, params: dict[str, Tensor], a: Tensor, b: Tensor) -> Tensor:
    """Of pairs of descriptors (M, N, dim) by M heads, (M, N)."""
    base = PairHead(kind, a.shape[-1]).to(a.device)

    def one(own: dict[str, Tensor], a: Tensor, b: Tensor) -> Tensor:
        result: Tensor = functional_call(base, own, (a, b))
        return result

    with torch.no_grad():
        each: Tensor = vmap(one)(params, a, b)
    return each


def choices() -> Iterator[tuple[str, HeadKind, bool]]:
    """Every way of fitting: its name, the kind of head, and whether it sees nearest wrong ones."""
    for kind in KINDS:
        yield f"frozen-{kind}", kind, False
        yield f"frozen-{kind}-mixed", kind, True
