"""FC4 in PyTorch: whether two descriptors show one object, trained beside them or after them."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from .config import HeadKind

_HIDDEN = 32


class PairHead(nn.Module):
    """The logarithm of the odds that two descriptors show one object.

    Parameters
    ----------
    kind : {"linear", "quadratic", "two_layer"}
        A linear map of the absolute difference; of that and its square, so that a weighted
        Euclidean distance is among what it can learn; or two layers with a ReLU between them.
    dim : int
    """

    def __init__(self, kind: HeadKind, dim: int) -> None:
        super().__init__()
        self.squares = kind == "quadratic"
        widths = [dim, _HIDDEN, 1] if kind == "two_layer" else [2 * dim if self.squares else dim, 1]
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """Logits of descriptors (..., dim) that broadcast; one axis less."""
        x = (a - b).abs()
        if self.squares:
            x = torch.cat([x, x.square()], dim=-1)
        for number, layer in enumerate(self.layers):
            x = layer(functional.relu(x) if number else x)
        return x.squeeze(-1)

    def tensors(self) -> dict[str, Tensor]:
        """As :class:`segloc.descriptors.pointset.PairHead` reads them."""
        found: dict[str, Tensor] = {}
        for number, layer in enumerate(self.layers):
            assert isinstance(layer, nn.Linear)
            found[f"pair.{number}.weight"] = layer.weight.detach().T
            found[f"pair.{number}.bias"] = layer.bias.detach()
        return found


def pair_loss(logits: Tensor, same: Tensor, *different: Tensor) -> Tensor:
    """Cross-entropy of FC4; pairs that match weigh as much as all kinds of others together.

    Parameters
    ----------
    logits : (...,)
    same : (...,) bool
        Pairs that match.
    *different : (...,) bool
        Pairs of one kind each that do not; the kinds weigh alike.
    """
    logits = logits.float()  # in single precision, whatever the network runs in
    positive = _mean(functional.softplus(-logits), same)
    negative = torch.stack([_mean(functional.softplus(logits), kind) for kind in different])
    return (positive + negative.mean()) / 2


def _mean(losses: Tensor, chosen: Tensor) -> Tensor:
    """Mean over the chosen, 0 without any; without indexing, so that it can be batched."""
    return losses.masked_fill(~chosen, 0.0).sum() / chosen.sum().clamp(min=1)
