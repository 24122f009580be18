"""Segments as the networks read them, many at once in PyTorch: changed, aligned, sampled.

The same steps as ``segloc._native.prepare_segments`` and :mod:`segloc_lab.training.augment`, which
a test compares; on a GPU all segments of a dataset take some seconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from segloc.descriptors.pointset import Layer

_SAMPLES = 256
_AT_ONCE = 8192
_MIN_POINTS = 20


def prepared(points: Tensor, sizes: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Aligned segments of 256 points in the order of farthest-point sampling, (P, 256, 3).

    Parameters
    ----------
    points : (P, S, 3) float32
        Of each segment the first ``sizes`` count.
    sizes : (P,) int64
    generator : torch.Generator, optional
        Where it is given, segments are changed at random first.
    """
    parts = []
    for first in range(0, len(points), _AT_ONCE):
        p, n = points[first : first + _AT_ONCE], sizes[first : first + _AT_ONCE]
        valid = torch.arange(p.shape[1], device=p.device)[None] < n[:, None]
        if generator is not None:
            p, valid = _augmented(p, valid, generator)
        parts.append(_sampled(_aligned(p, valid), valid))
    return torch.cat(parts)


def neighbors(points: Tensor, layers: Sequence[Layer]) -> list[Tensor]:
    """Dilated neighbours of every layer among prepared points (P, 256, 3): (P, N, K) int16 each."""
    found, sources = [], points.shape[1]
    for layer in layers:
        parts = []
        for p in points.split(_AT_ONCE // 4):
            apart = distances(p[:, : layer.points], p[:, :sources])
            near = apart.topk(layer.neighbors * layer.dilation, largest=False).indices
            parts.append(near[..., :: layer.dilation].to(torch.int16))
        found.append(torch.cat(parts))
        sources = layer.points
    return found


def distances(a: Tensor, b: Tensor) -> Tensor:
    """(..., N, M) Euclidean distances, each from its own differences: products round too much."""
    return torch.cdist(a, b, compute_mode="donot_use_mm_for_euclid_dist")


def _random(generator: torch.Generator, *shape: int) -> Tensor:
    return torch.rand(*shape, generator=generator, device=generator.device)


def _augmented(p: Tensor, valid: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Points dropped, a half-space cut off, one side thinned, noise: as in training."""
    P, S, _ = p.shape
    valid = _enough(valid, _random(generator, P, S) >= 0.1 * _random(generator, P, 1))
    normal = torch.randn(P, 3, generator=generator, device=p.device)
    normal[:, 2] *= 0.3
    along = (p * normal[:, None]).sum(dim=-1)
    share = 0.3 * _random(generator, P, 1) * (_random(generator, P, 1) < 0.5)
    ordered = along.masked_fill(~valid, math.inf).sort(dim=1).values
    limit = ordered.gather(1, (share * valid.sum(dim=1, keepdim=True)).long())
    valid = _enough(valid, along >= limit)
    angle = 2 * math.pi * _random(generator, P, 1)
    along = p[..., 0] * angle.cos() + p[..., 1] * angle.sin()
    low = along.masked_fill(~valid, math.inf).amin(dim=1, keepdim=True)
    high = along.masked_fill(~valid, -math.inf).amax(dim=1, keepdim=True)
    loss = _random(generator, P, 1) * (_random(generator, P, 1) < 0.3)
    gone = loss * (along - low) / (high - low).clamp(min=1e-6)
    valid = _enough(valid, _random(generator, P, S) >= gone)
    return p + 0.02 * torch.randn(p.shape, generator=generator, device=p.device), valid


def _enough(valid: Tensor, keep: Tensor) -> Tensor:
    """Those of ``valid`` to keep; all of them where fewer than 20 points would stay."""
    kept = valid & keep
    return torch.where((kept.sum(dim=1) >= _MIN_POINTS)[:, None], kept, valid)


def _aligned(p: Tensor, valid: Tensor) -> Tensor:
    """Centred, the major horizontal axis along x, the half with more points at low y."""
    weight = valid[..., None].to(p.dtype)
    count = weight.sum(dim=1, keepdim=True)
    p = (p - (p * weight).sum(dim=1, keepdim=True) / count) * weight
    xx, xy, yy = ((p[..., i] * p[..., j]).double().sum(dim=1) for i, j in ((0, 0), (0, 1), (1, 1)))
    angle = 0.5 * torch.atan2(2 * xy, xx - yy)
    c, s = angle.cos().float()[:, None], angle.sin().float()[:, None]
    x, y = c * p[..., 0] + s * p[..., 1], c * p[..., 1] - s * p[..., 0]
    low = y.masked_fill(~valid, math.inf).amin(dim=1, keepdim=True)
    high = y.masked_fill(~valid, -math.inf).amax(dim=1, keepdim=True)
    below = (valid & (y < (low + high) / 2)).sum(dim=1)
    sign = torch.where(2 * below < valid.sum(dim=1), -1.0, 1.0).to(p.dtype)[:, None]
    return torch.stack([sign * x, sign * y, p[..., 2]], dim=-1)


def _sampled(p: Tensor, valid: Tensor) -> Tensor:
    """The first 256 points by farthest-point sampling, repeated where there are fewer."""
    rows = torch.arange(len(p), device=p.device)
    apart = p.square().sum(dim=-1).masked_fill(~valid, -1.0)
    chosen = apart.argmax(dim=1)
    least = torch.full_like(apart, math.inf).masked_fill(~valid, -1.0)
    order = [chosen]
    for _ in range(_SAMPLES - 1):
        least = torch.minimum(least, (p - p[rows, chosen][:, None]).square().sum(dim=-1))
        least = least.scatter(1, chosen[:, None], -0.5).masked_fill(~valid, -1.0)
        chosen = least.argmax(dim=1)
        order.append(chosen)
    sizes = valid.sum(dim=1).clamp(max=_SAMPLES)
    places = torch.arange(_SAMPLES, device=p.device)[None] % sizes[:, None]
    return p[rows[:, None], torch.stack(order, dim=1).gather(1, places)]
