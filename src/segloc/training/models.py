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

from .. import _native
from ..descriptors.pointset import DSM_LAYERS, ESM_LAYERS, Layer

LAYERS = {"dsm": DSM_LAYERS, "esm": ESM_LAYERS}
DIM = 16


class Norm(nn.BatchNorm1d):
    """Batch norm over the last axis of a tensor of any rank."""

    def __init__(self, channels: int) -> None:
        super().__init__(channels, eps=1e-3, momentum=0.1)

    def forward(self, x: Tensor) -> Tensor:
        return super().forward(x.reshape(-1, self.num_features)).reshape(x.shape)


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
        self.x2_norm = Norm(K * K)
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
        relative = _gather(points, neighbors) - points[:, : neighbors.shape[1], None]
        gathered = self._lift(relative)
        if features is not None:
            gathered = torch.cat([gathered, _gather(features, neighbors)], dim=-1)
        transformed = self._transform(relative) @ gathered
        separated = torch.einsum("bnkc,kcm->bncm", transformed, self.depthwise).flatten(2)
        out: Tensor = self.norm(functional.elu(separated @ self.pointwise))
        return out

    def _lift(self, relative: Tensor) -> Tensor:
        hidden = self.lift1_norm(functional.elu(relative @ self.lift1))
        lifted: Tensor = self.lift2_norm(functional.elu(hidden @ self.lift2))
        return lifted

    def _transform(self, relative: Tensor) -> Tensor:
        """The K x K matrix of each query; a depthwise map makes row c from column c."""
        B, N, K, _ = relative.shape
        x = functional.elu(relative.reshape(B, N, 3 * K) @ self.x0.flatten(1))
        x = self.x0_norm(x).view(B, N, K, K)
        x = functional.elu(torch.einsum("bnic,ico->bnco", x, self.x1))
        x = self.x1_norm(x.flatten(2)).view(B, N, K, K)
        x = torch.einsum("bnic,ico->bnco", x, self.x2)
        return self.x2_norm(x.flatten(2)).view(B, N, K, K)


def _gather(values: Tensor, index: Tensor) -> Tensor:
    """values (B, S, C), index (B, N, K) -> (B, N, K, C)."""
    B, S, C = values.shape
    base = torch.arange(B, device=values.device).view(B, 1, 1) * S
    return values.reshape(B * S, C)[index + base]


class DescriptorNetwork(nn.Module):
    """Prepared segments to descriptors.

    ``trunk_parameters`` counts what the paper counts: everything up to the descriptor. The two
    heads add 51 more. `pair_head` (FC4) sees the absolute difference of two descriptors and says
    whether they match. `quality_head` sees one descriptor and says how likely its nearest
    neighbour is to be a true match.
    """

    def __init__(self, layers: Sequence[Layer], dim: int = DIM) -> None:
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
        self.pair_head = nn.Linear(dim, 2)
        self.quality_head = nn.Linear(dim, 1)

    def trunk_parameters(self) -> int:
        """Number of parameters up to the descriptor."""
        heads = sum(p.numel() for head in self._heads() for p in head.parameters())
        return sum(p.numel() for p in self.parameters()) - heads

    def _heads(self) -> tuple[nn.Linear, nn.Linear]:
        return self.pair_head, self.quality_head

    def neighbors(self, points: Tensor, threads: int = 1) -> list[Tensor]:
        """Dilated neighbours of every layer, (B, N, K) int64 each."""
        array = points.detach().numpy()
        result, sources = [], points.shape[1]
        for layer in self.layers:
            index = _native.dilated_neighbors(
                array, sources, layer.points, layer.neighbors, layer.dilation, threads
            )
            result.append(torch.from_numpy(index))
            sources = layer.points
        return result

    def activations(self, points: Tensor) -> list[Tensor]:
        """What each X-conv layer makes of prepared segments (B, 256, 3): (B, N, C) each."""
        features, result = None, []
        for xconv, index in zip(self.xconvs, self.neighbors(points), strict=True):
            features = xconv(points, features, index)
            points = points[:, : index.shape[1]]
            result.append(features)
        return result

    def forward(self, points: Tensor) -> Tensor:
        """Descriptors (B, dim) of prepared segments (B, 256, 3), float32."""
        last = self.activations(points)[-1]
        position = points[:, : last.shape[1]]
        position = self.global1_norm(functional.elu(position @ self.global1))
        position = self.global2_norm(functional.elu(position @ self.global2))
        pooled = torch.cat([last, position], dim=-1).mean(dim=1)
        hidden = self.fc1_norm(functional.elu(pooled @ self.fc1))
        hidden = self.fc2_norm(functional.elu(hidden @ self.fc2))
        descriptors: Tensor = self.fc3(hidden)
        return descriptors

    def quality(self, descriptors: Tensor) -> Tensor:
        """Probability that a descriptor's nearest neighbour is a true match, (B,)."""
        return torch.sigmoid(self.quality_head(descriptors)).squeeze(-1)

    def pair_logits(self, a: Tensor, b: Tensor) -> Tensor:
        """Logits (B, 2) of "no match" and "match" for pairs of descriptors."""
        logits: Tensor = self.pair_head((a - b).abs())
        return logits
