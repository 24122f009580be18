"""Which segments the networks of a stack see at a step, drawn on the device that trains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .compact import FAR_M, Segments

_OBJECTS, _HARD, _ACROSS = 32, 16, 0.8


@dataclass(frozen=True)
class Batch:
    """What M networks see: two segments each of 32 objects.

    Attributes
    ----------
    indices : (M, 64) int64
    same, different : (M, 64, 64) bool
        Pairs that are neither say nothing.
    far : (M, 64, 64) bool
        Those of ``different`` that were drawn at random, not because they are easily mistaken.
    """

    indices: Tensor
    same: Tensor
    different: Tensor
    far: Tensor


class Objects:
    """The segments of a training split, by object.

    Parameters
    ----------
    segments : Segments
    device : torch.device

    Attributes
    ----------
    points : (P, 320, 3) float32
    sizes : (P,) int64
    kept : (P,) int64
        Of the training split, those that are not held out.
    """

    def __init__(self, segments: Segments, device: torch.device) -> None:
        self.device = device
        self.kept = np.flatnonzero(~segments.held)
        points, sizes = segments.padded()
        self.points = torch.from_numpy(points[self.kept]).to(device)
        self.sizes = torch.from_numpy(sizes[self.kept]).to(device)
        labels, sessions = segments.labels[self.kept], segments.sessions[self.kept]
        self._labels = torch.from_numpy(labels).to(device)
        self._places = torch.from_numpy(segments.places[self.kept]).to(device)
        self._centroids = torch.from_numpy(segments.centroids[self.kept]).to(device)
        groups = _groups(labels)
        near = [_pairs(group) for group in groups]
        across = [_pairs(group, sessions) for group in groups]
        across = [far if len(far) else own for far, own in zip(across, near, strict=True)]
        self._any, self._across = _Table(near, device), _Table(across, device)

    def __len__(self) -> int:
        return len(self._any)

    def first_views(self) -> Tensor:
        """(G,) a segment of each object."""
        return self._any.first()

    def draw(self, seeds: Sequence[int], step: int, variants: int, rivals: Tensor | None) -> Batch:
        """The batch of a step; networks of one seed share its random objects.

        Parameters
        ----------
        seeds : sequence of int
        step : int
        variants : int
            Networks of each seed; the first axis is variant by variant.
        rivals : (M, G, 16) int64 or None
            For every object those that are easily taken for it; half of a batch are such.
        """
        rows = [self._random(seed, step) for seed in seeds]
        chosen, pick, which, across = (
            torch.stack(each).repeat(variants, *[1] * rows[0][k].dim())
            for k, each in enumerate(zip(*rows, strict=True))
        )
        if rivals is not None:
            asked = rivals.gather(1, chosen[:, :_HARD, None].expand(-1, -1, rivals.shape[2]))
            hard = asked.gather(2, which[:, :_HARD, None]).squeeze(-1)
            chosen = torch.cat([chosen[:, :_HARD], hard], dim=1)
        near, far = self._any.pairs(chosen, pick), self._across.pairs(chosen, pick)
        indices = torch.where(across[..., None], far, near).flatten(1)
        return self._related(indices, rivals is not None)

    def _random(self, seed: int, step: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        generator = torch.Generator().manual_seed(1_000_003 * seed + step)
        chosen = torch.randint(len(self), (_OBJECTS,), generator=generator)
        pick = torch.rand(_OBJECTS, generator=generator)
        which = torch.randint(16, (_OBJECTS,), generator=generator)
        across = torch.rand(_OBJECTS, generator=generator) < _ACROSS
        chosen, pick, which, across = (t.to(self.device) for t in (chosen, pick, which, across))
        return chosen, pick, which, across

    def _related(self, indices: Tensor, mined: bool) -> Batch:
        labels, places = self._labels[indices], self._places[indices]
        at = self._centroids[indices]
        same = labels[:, :, None] == labels[:, None]
        apart = (at[:, :, None] - at[:, None]).norm(dim=-1) > FAR_M
        different = ~same & (apart | (places[:, :, None] != places[:, None]))
        self_pair = torch.eye(indices.shape[1], dtype=torch.bool, device=self.device)
        random = torch.ones(indices.shape[1], dtype=torch.bool, device=self.device)
        if mined:
            random[2 * _HARD :] = False
        far = different & random[:, None] & random[None]
        return Batch(indices, same & ~self_pair, different, far)


class _Table:
    """Pairs of segments of each object, of which one is drawn by a number in [0, 1)."""

    def __init__(self, pairs: list[NDArray[np.int64]], device: torch.device) -> None:
        counts = np.array([len(each) for each in pairs])
        self._pairs = torch.from_numpy(np.concatenate(pairs)).to(device)
        self._counts = torch.from_numpy(counts).to(device)
        self._starts = torch.from_numpy(np.cumsum(counts) - counts).to(device)

    def __len__(self) -> int:
        return len(self._counts)

    def first(self) -> Tensor:
        return self._pairs[self._starts, 0]

    def pairs(self, objects: Tensor, pick: Tensor) -> Tensor:
        """(..., 2) a pair of each object."""
        count = self._counts[objects]
        return self._pairs[self._starts[objects] + (pick * count).long().clamp(max=count - 1)]


def _groups(labels: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    order = np.argsort(labels, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)
    return [part for part in parts if len(part) > 1]


def _pairs(
    group: NDArray[np.int64], sessions: NDArray[np.int64] | None = None
) -> NDArray[np.int64]:
    """(n, 2) the pairs of an object's segments; of different sessions where these are given."""
    i, j = np.triu_indices(len(group), 1)
    pairs = np.column_stack([group[i], group[j]])
    if sessions is None:
        return pairs
    across: NDArray[np.int64] = pairs[sessions[pairs[:, 0]] != sessions[pairs[:, 1]]]
    return across
