"""The descriptor networks in PyTorch, for training.

X-conv after Li et al., "PointCNN" (NeurIPS 2018), with its order of linear map, ELU, batch norm.
Convolutions over neighbours are written as matrix products: on a CPU they are several times faster
than grouped Conv1d, and equal.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from segloc import _native
from segloc.descriptors.pointset import DIM, DSM_LAYERS, ESM_LAYERS, Layer
from segloc.types import Float32

from .config import HeadKind
from .ops import column_maps, elu_norm, gather, xconv_apply
from .pair_heads import PairHead

LAYERS = {"dsm": DSM_LAYERS, "esm": ESM_LAYERS}


class Norm(nn.Module):
    """Batch norm over the last axis of a tensor of any rank, after ELU unless it is linear."""

    running_mean: Tensor
    running_var: Tensor

    def __init__(self, channels: int, activate: bool = True) -> None:
        super().__init__()
        self.eps, self.momentum, self.activate = 1e-3, 0.1, activate
        self.weight = nn.Parameter(torch.ones(channels))
        self.bias = nn.Parameter(torch.zeros(channels))
        self.register_buffer("running_mean", torch.zeros(channels))
        self.register_buffer("running_var", torch.ones(channels))

    def forward(self, x: Tensor) -> Tensor:
        if not self.training:
            x = functional.elu(x) if self.activate else x
            scale = self.weight * torch.rsqrt(self.running_var + self.eps)
            return (x - self.running_mean) * scale + self.bias
        flat = x.reshape(-1, x.shape[-1])
        output, mean, variance = elu_norm(flat, self.weight, self.bias, self.eps, self.activate)
        with torch.no_grad():
            unbiased = variance * (len(flat) / max(1, len(flat) - 1))
            # As lerp_, which torch.vmap would do network by network.
            self.running_mean.add_(self.momentum * (mean - self.running_mean))
            self.running_var.add_(self.momentum * (unbiased - self.running_var))
        return output.view(x.shape)


def _weight(*shape: int, inputs: int) -> nn.Parameter:
    """Uniform with the variance 1 / inputs."""
    bound = (3.0 / inputs) ** 0.5
    return nn.Parameter(torch.empty(*shape).uniform_(-bound, bound))


class XConv(nn.Module):
    """One X-conv layer.

    Parameters
    ----------
    layer : Layer
    inputs : int
        Channels of the layer before; 0 for the first, which sees positions only.
    """

    def __init__(self, layer: Layer, inputs: int) -> None:
        super().__init__()
        K, C = layer.neighbors, layer.channels
        lifted = inputs // 4 if inputs else C // 2
        depth = -(-C // inputs) if inputs else 4
        channels = lifted + inputs
        self.layer = layer
        self.lift1 = _weight(3, lifted, inputs=3)
        self.lift1_norm = Norm(lifted)
        self.lift2 = _weight(lifted, lifted, inputs=lifted)
        self.lift2_norm = Norm(lifted)
        self.x0 = _weight(3 * K, K, K, inputs=3 * K)
        self.x0_norm = Norm(K * K)
        self.x1 = _weight(K, K, K, inputs=K)
        self.x1_norm = Norm(K * K)
        self.x2 = _weight(K, K, K, inputs=K)
        self.x2_norm = Norm(K * K, activate=False)
        self.depthwise = _weight(K, channels, depth, inputs=K)
        self.pointwise = _weight(channels * depth, C, inputs=channels * depth)
        self.norm = Norm(C)

    def forward(self, points: Tensor, features: Tensor | None, neighbors: Tensor) -> Tensor:
        """Features of the layer's points.

        Parameters
        ----------
        points : (B, S, 3)
        features : (B, S, inputs) or None
        neighbors : (B, N, K) int64

        Returns
        -------
        (B, N, C)
        """
        relative = gather(points, neighbors) - points[:, : neighbors.shape[1], None]
        # Of the weights of channel c and multiple m the parameters keep the paper's order.
        depthwise = self.depthwise.permute(2, 0, 1)
        separated = xconv_apply(
            self._transform(relative), self._lift(relative), features, neighbors, depthwise
        )
        _, channels, depth = self.depthwise.shape
        pointwise = self.pointwise.view(channels, depth, -1).transpose(0, 1).flatten(0, 1)
        out: Tensor = self.norm(separated.flatten(2) @ pointwise)
        return out

    def _lift(self, relative: Tensor) -> Tensor:
        lifted: Tensor = self.lift2_norm(self.lift1_norm(relative @ self.lift1) @ self.lift2)
        return lifted

    def _transform(self, relative: Tensor) -> Tensor:
        """The K x K matrix of each query."""
        B, N, K, _ = relative.shape
        x = self.x0_norm(relative.reshape(B, N, 3 * K) @ self.x0.flatten(1))
        x = column_maps(x.view(B, N, K, K), self.x1)
        x = column_maps(self.x1_norm(x.flatten(2)).view(B, N, K, K), self.x2)
        result: Tensor = self.x2_norm(x.flatten(2)).view(B, N, K, K)
        return result


def neighbors_of(points: Float32, layers: Sequence[Layer], threads: int = 1) -> list[Tensor]:
    """Dilated neighbours of every layer among points (B, S, 3): (B, N, K) int64 each."""
    result, sources = [], points.shape[1]
    for layer in layers:
        index = _native.dilated_neighbors(
            points, sources, layer.points, layer.neighbors, layer.dilation, threads
        )
        result.append(torch.from_numpy(index))
        sources = layer.points
    return result


class DescriptorNetwork(nn.Module):
    """Prepared segments to descriptors.

    ``trunk_parameters`` counts what the paper counts: everything up to the descriptor. `pair_head`
    (FC4) sees the difference of two descriptors and says whether they match. `quality_head` sees
    one descriptor and says how likely its nearest neighbour is to be a true match.
    """

    def __init__(
        self, layers: Sequence[Layer], dim: int = DIM, pair_head: HeadKind = "linear"
    ) -> None:
        super().__init__()
        self.layers = tuple(layers)
        inputs = [0] + [layer.channels for layer in self.layers[:-1]]
        self.xconvs = nn.ModuleList(
            XConv(layer, count) for layer, count in zip(self.layers, inputs, strict=True)
        )
        C = self.layers[-1].channels
        G = C // 4
        self.global1 = _weight(3, G, inputs=3)
        self.global1_norm = Norm(G)
        self.global2 = _weight(G, G, inputs=G)
        self.global2_norm = Norm(G)
        self.fc1 = _weight(C + G, 256, inputs=C + G)
        self.fc1_norm = Norm(256)
        self.fc2 = _weight(256, 128, inputs=256)
        self.fc2_norm = Norm(128)
        self.fc3 = nn.Linear(128, dim)
        self.pair_head = PairHead(pair_head, dim)
        self.quality_head = nn.Linear(dim, 1)

    def trunk_parameters(self) -> int:
        """Number of parameters up to the descriptor."""
        heads = sum(p.numel() for head in self._heads() for p in head.parameters())
        return sum(p.numel() for p in self.parameters()) - heads

    def _heads(self) -> tuple[nn.Module, nn.Module]:
        return self.pair_head, self.quality_head

    def activations(self, points: Tensor, *neighbors: Tensor) -> list[Tensor]:
        """What each X-conv layer makes of prepared segments (B, 256, 3): (B, N, C) each."""
        features, result = None, []
        found = neighbors or neighbors_of(points.detach().numpy(), self.layers)
        for xconv, index in zip(self.xconvs, found, strict=True):
            features = xconv(points, features, index)
            points = points[:, : index.shape[1]]
            result.append(features)
        return result

    def forward(self, points: Tensor, *neighbors: Tensor) -> Tensor:
        """Descriptors (B, dim) of prepared segments (B, 256, 3), float32.

        The neighbours of every layer, (B, N, K) int64 each, are searched where they are not given.
        """
        last = self.activations(points, *neighbors)[-1]
        position = points[:, : last.shape[1]]
        position = self.global1_norm(position @ self.global1)
        position = self.global2_norm(position @ self.global2)
        pooled = torch.cat([last, position], dim=-1).mean(dim=1)
        hidden = self.fc1_norm(pooled @ self.fc1)
        hidden = self.fc2_norm(hidden @ self.fc2)
        descriptors: Tensor = self.fc3(hidden)
        return descriptors

    def quality(self, descriptors: Tensor) -> Tensor:
        """Probability that a descriptor's nearest neighbour is a true match, (B,)."""
        return torch.sigmoid(self.quality_head(descriptors)).squeeze(-1)

    def pair_logits(self, a: Tensor, b: Tensor) -> Tensor:
        """The logarithm of the odds (...,) that descriptors (..., dim) are of one object."""
        logits: Tensor = self.pair_head(a, b)
        return logits
