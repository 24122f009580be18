"""FC4 fitted to finished descriptors: its kinds, on pairs of several origins."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from segloc.training.config import HeadKind
from segloc.training.pair_heads import PairHead, pair_loss
from torch import Tensor
from torch.func import functional_call, stack_module_state, vmap

from .compact import Segments

_FAR_M = 20.0
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


def draw_pairs(
    segments: Segments, rows: np.ndarray, vectors: Tensor, count: int, seed: int = 0
) -> Pairs:
    """Pairs among some segments, as many of each kind; the nearest ones by each network's vectors.

    Parameters
    ----------
    segments : Segments
    rows : (R,) int64
        The segments that ``vectors`` describe.
    vectors : (M, R, dim)
    count : int
        Of each kind.
    seed : int
    """
    rng = np.random.default_rng(seed)
    labels, device = segments.labels[rows], vectors.device
    groups = [g for g in np.split(*_sorted(labels)) if len(g) > 1]
    chosen = rng.integers(len(groups), size=count)
    same = np.array([rng.choice(groups[g], 2, replace=False) for g in chosen])
    drawn = rng.integers(len(rows), size=(4 * count, 2))
    far = drawn[_differ(segments, rows, *drawn.T)][:count]
    fixed = torch.from_numpy(np.concatenate([same, far])).to(device).expand(len(vectors), -1, -1)
    queries = rng.integers(len(rows), size=count)
    wrong = torch.from_numpy(_differ(segments, rows, queries[:, None], np.arange(len(rows)))).to(device)
    near = []
    for own in vectors:
        apart = torch.cdist(own[queries], own).masked_fill(~wrong, torch.inf)
        near.append(apart.topk(5, largest=False).indices[:, int(rng.integers(5))])
    hard = torch.stack([torch.from_numpy(queries).to(device).expand(len(vectors), -1), torch.stack(near)], dim=2)
    pairs = torch.cat([fixed, hard], dim=1)
    kind = torch.tensor([0] * len(same) + [1] * len(far) + [2] * len(queries), device=device)
    return Pairs(pairs[..., 0], pairs[..., 1], kind)


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


def _sorted(labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(labels, kind="stable")
    return order, np.flatnonzero(np.diff(labels[order])) + 1


def _differ(segments: Segments, rows: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Whether segments (broadcast) surely show different objects."""
    a, b = rows[a], rows[b]
    at = segments.centroids
    apart = ((at[a] - at[b]) ** 2).sum(axis=-1) > _FAR_M**2
    differ: np.ndarray = (segments.labels[a] != segments.labels[b]) & (
        apart | (segments.places[a] != segments.places[b])
    )
    return differ
