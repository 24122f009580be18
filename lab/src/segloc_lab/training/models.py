"""The descriptor networks in PyTorch, for training.

X-conv after Li et al., "PointCNN" (NeurIPS 2018), in its order of linear map, ELU, batch norm.
Convolutions over neighbours are matrix products: on a CPU several times faster than grouped
Conv1d, with equal results.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from segloc.descriptors.pointset import DIM, DSM_LAYERS, ESM_LAYERS, Alignment, Layer
from segloc.system import kernels
from segloc.types import Float32

from .config import HeadKind
from .pair_fitting import PairHead
from .writing import write_network

_NATIVE = ContextVar("native", default=True)


@contextmanager
def torch_forms() -> Iterator[None]:
    """Use torch operations on the CPU, too: to export a network, or to compare it."""
    token = _NATIVE.set(False)
    try:
        yield
    finally:
        _NATIVE.reset(token)


def _is_native(*tensors: Tensor) -> bool:
    return _NATIVE.get() and all(
        t.device.type == "cpu" and t.dtype == torch.float32 for t in tensors
    )


def _array(tensor: Tensor) -> Any:
    return tensor.detach().contiguous().numpy()


def elu_norm(
    x: Tensor, weight: Tensor, bias: Tensor, eps: float, activate: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Apply batch norm over the columns of (R, C), after ELU if ``activate`` is set.

    Returns
    -------
    output : (R, C)
    mean, variance : (C,)
        Of the batch; the variance is biased. No gradient.
    """
    if _is_native(x, weight, bias):
        return _EluNorm.apply(x, weight, bias, eps, activate)
    z = functional.elu(x) if activate else x
    output = functional.batch_norm(z, None, None, weight, bias, True, 0.0, eps)
    variance, mean = torch.var_mean(z.detach().float(), dim=0, correction=0)
    return output, mean, variance


class _EluNorm(torch.autograd.Function):
    @staticmethod
    def forward(  # type: ignore[no-untyped-def]
        ctx, x: Tensor, weight: Tensor, bias: Tensor, eps: float, activate: bool
    ) -> tuple[Tensor, Tensor, Tensor]:
        x = x.contiguous()
        output = torch.empty_like(x)
        z = torch.empty_like(x) if activate else x
        mean, variance = torch.empty_like(weight), torch.empty_like(weight)
        given = (_array(x), activate, _array(weight), _array(bias), eps)
        results = [_array(t) for t in (z, output, mean, variance)]
        kernels.elu_norm(*given, *results, threads=torch.get_num_threads())  # type: ignore[misc]
        ctx.save_for_backward(z, weight, mean, variance)
        ctx.eps, ctx.activate = eps, activate
        ctx.mark_non_differentiable(mean, variance)
        return output, mean, variance

    @staticmethod
    def backward(ctx, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[no-untyped-def]
        z, weight, mean, variance = ctx.saved_tensors
        x, w, b = torch.empty_like(z), torch.empty_like(weight), torch.empty_like(weight)
        given = (_array(gradients[0]), _array(z), ctx.activate, _array(weight), ctx.eps)
        arrays = [_array(t) for t in (mean, variance, x, w, b)]
        threads = torch.get_num_threads()
        kernels.elu_norm_backward(*given, *arrays, threads=threads)  # type: ignore[misc]
        return x, w, b, None, None


def xconv_apply(
    x: Tensor, lift: Tensor, features: Tensor | None, neighbors: Tensor, depthwise: Tensor
) -> Tensor:
    """Transform the features of each point's neighbours, and convolve them over the neighbours.

    Parameters
    ----------
    x : (B, N, K, K)
    lift : (B, N, K, L)
    features : (B, S, F) or None
        Gathered by ``neighbors`` and appended to ``lift``.
    neighbors : (B, N, K) int64
    depthwise : (D, K, L + F)

    Returns
    -------
    (B, N, D, L + F)
    """
    if _is_native(x, lift, depthwise) and (features is None or _is_native(features)):
        held = lift.new_empty(len(lift), 1, 0) if features is None else features
        return _Apply.apply(x, lift, held, neighbors, depthwise)
    gathered = lift if features is None else torch.cat([lift, gather(features, neighbors)], dim=-1)
    return torch.einsum("bnkc,mkc->bnmc", x @ gathered, depthwise.to(gathered.dtype))


class _Apply(torch.autograd.Function):
    @staticmethod
    def forward(ctx, *inputs: Tensor) -> Tensor:  # type: ignore[no-untyped-def]
        inputs = tuple(t.contiguous() for t in inputs)
        _, lift, features, neighbors, depthwise = inputs
        B, N, _ = neighbors.shape
        channels = lift.shape[-1] + features.shape[-1]
        output = lift.new_empty(B, N, len(depthwise), channels)
        arrays = [_array(t) for t in (*inputs, output)]
        kernels.xconv_apply(*arrays, threads=torch.get_num_threads())  # type: ignore[misc]
        ctx.save_for_backward(*inputs)
        return output

    @staticmethod
    def backward(ctx, gradient: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[no-untyped-def]
        inputs = ctx.saved_tensors
        x, lift, features, _, depthwise = results = [torch.empty_like(t) for t in inputs]
        arrays = [_array(t) for t in (*inputs, gradient, x, lift, features, depthwise)]
        threads = torch.get_num_threads()
        kernels.xconv_apply_backward(*arrays, threads=threads)  # type: ignore[misc]
        results[3] = None
        return tuple(results)


def column_maps(x: Tensor, weight: Tensor) -> Tensor:
    """Apply a depthwise map of matrices: row c of the result comes from column c.

    Parameters
    ----------
    x : (..., K, K)
    weight : (K, K, K)
        The result at (c, o) is the sum over i of x at (i, c) times the weight at (i, c, o).
    """
    if _is_native(x, weight):
        return _ColumnMaps.apply(x, weight)
    # Most of this matrix is zero, yet one large product is faster than K small ones.
    K = len(weight)
    eye = torch.eye(K, dtype=weight.dtype, device=weight.device)
    diagonals = weight.transpose(1, 2).unsqueeze(-1) * eye  # as diag_embed, which ONNX lacks
    matrix = diagonals.permute(0, 2, 3, 1).reshape(K * K, K * K)
    return (x.flatten(-2) @ matrix.to(x.dtype)).view(x.shape)


class _ColumnMaps(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x: Tensor, weight: Tensor) -> Tensor:  # type: ignore[no-untyped-def]
        x, weight = x.contiguous(), weight.contiguous()
        K = len(weight)
        output = torch.empty_like(x)
        arrays = [_array(t) for t in (x.view(-1, K, K), weight, output)]
        kernels.column_maps(*arrays, threads=torch.get_num_threads())  # type: ignore[misc]
        ctx.save_for_backward(x, weight)
        return output

    @staticmethod
    def backward(ctx, gradient: Tensor) -> tuple[Tensor, Tensor]:  # type: ignore[no-untyped-def]
        x, weight = ctx.saved_tensors
        K = len(weight)
        grad_x, grad_weight = torch.empty_like(x), torch.empty_like(weight)
        flat = gradient.contiguous().view(-1, K, K)
        arrays = [_array(t) for t in (x.view(-1, K, K), weight, flat, grad_x, grad_weight)]
        threads = torch.get_num_threads()
        kernels.column_maps_backward(*arrays, threads=threads)  # type: ignore[misc]
        return grad_x, grad_weight


def gather(values: Tensor, index: Tensor) -> Tensor:
    """Gather values (B, S, C) by index (B, N, K) to (B, N, K, C)."""
    B, S, C = values.shape
    base = torch.arange(B, device=values.device).view(B, 1, 1) * S
    return values.reshape(B * S, C)[index + base]


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
    """Return uniform weights with variance 1 / inputs."""
    bound = (3.0 / inputs) ** 0.5
    return nn.Parameter(torch.empty(*shape).uniform_(-bound, bound))


class XConv(nn.Module):
    """One X-conv layer.

    Parameters
    ----------
    inputs : int
        Channels of the previous layer; 0 for the first, which has positions only.
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
        """Return features of the layer's points.

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
        return self.norm(separated.flatten(2) @ pointwise)

    def _lift(self, relative: Tensor) -> Tensor:
        return self.lift2_norm(self.lift1_norm(relative @ self.lift1) @ self.lift2)

    def _transform(self, relative: Tensor) -> Tensor:
        """Return the K x K matrix of each query."""
        B, N, K, _ = relative.shape
        x = self.x0_norm(relative.reshape(B, N, 3 * K) @ self.x0.flatten(1))
        x = column_maps(x.view(B, N, K, K), self.x1)
        x = column_maps(self.x1_norm(x.flatten(2)).view(B, N, K, K), self.x2)
        return self.x2_norm(x.flatten(2)).view(B, N, K, K)


def neighbors_of(points: Float32, layers: Sequence[Layer], threads: int = 1) -> list[Tensor]:
    """Return dilated neighbours of every layer among points (B, S, 3): (B, N, K) int64 each."""
    result, sources = [], points.shape[1]
    for layer in layers:
        index = kernels.dilated_neighbors(
            points, sources, layer.points, layer.neighbors, layer.dilation, threads
        )
        result.append(torch.from_numpy(index))
        sources = layer.points
    return result


class DescriptorNetwork(nn.Module):
    """Map prepared segments to descriptors.

    ``trunk_parameters`` counts parameters as the paper does: up to the descriptor. `pair_head`
    (FC4) classifies the difference of two descriptors as matching or not. `quality_head` estimates
    the probability that a descriptor's nearest neighbour is correct.
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
        heads = (self.pair_head, self.quality_head)
        rest = sum(p.numel() for head in heads for p in head.parameters())
        return sum(p.numel() for p in self.parameters()) - rest

    def activations(self, points: Tensor, *neighbors: Tensor) -> list[Tensor]:
        """Return the output of each X-conv layer for prepared segments (B, 256, 3): (B, N, C)."""
        features, result = None, []
        found = neighbors or neighbors_of(points.detach().numpy(), self.layers)
        for xconv, index in zip(self.xconvs, found, strict=True):
            features = xconv(points, features, index)
            points = points[:, : index.shape[1]]
            result.append(features)
        return result

    def forward(self, points: Tensor, *neighbors: Tensor) -> Tensor:
        """Return descriptors (B, dim) of prepared segments (B, 256, 3), float32.

        ``neighbors`` of every layer, (B, N, K) int64 each, are searched if not given.
        """
        last = self.activations(points, *neighbors)[-1]
        position = points[:, : last.shape[1]]
        position = self.global1_norm(position @ self.global1)
        position = self.global2_norm(position @ self.global2)
        pooled = torch.cat([last, position], dim=-1).mean(dim=1)
        hidden = self.fc1_norm(pooled @ self.fc1)
        return self.fc3(self.fc2_norm(hidden @ self.fc2))

    def quality(self, descriptors: Tensor) -> Tensor:
        """Return the probability that a descriptor's nearest neighbour is correct, (B,)."""
        return torch.sigmoid(self.quality_head(descriptors)).squeeze(-1)

    def pair_logits(self, a: Tensor, b: Tensor) -> Tensor:
        """Return the log-odds (...,) that descriptors (..., dim) are of one object."""
        return self.pair_head(a, b)


def export(
    model: DescriptorNetwork,
    path: Path,
    card: Mapping[str, Any],
    alignment: Alignment = "pca2d",
    *,
    with_pairs: bool = False,
) -> None:
    """Write the weights file for inference.

    card: origin of the weights: data, command, figures, licence
    with_pairs: True to include FC4
    """
    pairs = model.pair_head.tensors() if with_pairs else {}
    arrays = {name: np.ascontiguousarray(tensor.numpy()) for name, tensor in pairs.items()}
    write_network(path, {**folded(model), **arrays}, model.layers, alignment, card)


@torch.no_grad()
def folded(model: DescriptorNetwork) -> dict[str, Float32]:
    """Return the tensors of inference (see cpp/network.h).

    A batch norm is folded into an adjacent linear map; before the X-transform or the mean it
    remains as scale and shift. Computed in double precision.
    """
    tensors: dict[str, Tensor] = {}
    for index, layer in enumerate(model.xconvs):
        tensors |= {f"layers.{index}.{name}": t for name, t in _xconv(layer).items()}
    a, b = _affine(model.global1_norm)
    tensors["global1.weight"] = model.global1.double()
    tensors["global2.weight"] = a[:, None] * model.global2.double()
    tensors["global2.bias"] = b @ model.global2.double()
    tensors["global2.scale"], tensors["global2.shift"] = _affine(model.global2_norm)
    tensors["fc1.weight"] = model.fc1.double()
    tensors["fc1.bias"] = torch.zeros(model.fc1.shape[1])
    a, b = _affine(model.fc1_norm)
    tensors["fc2.weight"] = a[:, None] * model.fc2.double()
    tensors["fc2.bias"] = b @ model.fc2.double()
    a, b = _affine(model.fc2_norm)
    fc3 = model.fc3.weight.double().T
    tensors["fc3.weight"] = a[:, None] * fc3
    tensors["fc3.bias"] = b @ fc3 + model.fc3.bias
    tensors["quality.weight"] = model.quality_head.weight.T
    tensors["quality.bias"] = model.quality_head.bias
    return {name: tensor.numpy().astype(np.float32) for name, tensor in tensors.items()}


def _affine(norm: Norm) -> tuple[Tensor, Tensor]:
    """Return scale and shift of a batch norm at inference."""
    scale = norm.weight.double() / torch.sqrt(norm.running_var.double() + norm.eps)
    return scale, norm.bias.double() - norm.running_mean.double() * scale


def _xconv(layer: XConv) -> dict[str, Tensor]:
    K = layer.layer.neighbors
    tensors: dict[str, Tensor] = {"lift1.weight": layer.lift1.double()}
    a, b = _affine(layer.lift1_norm)
    tensors["lift2.weight"] = a[:, None] * layer.lift2.double()
    tensors["lift2.bias"] = b @ layer.lift2.double()
    tensors["lift2.scale"], tensors["lift2.shift"] = _affine(layer.lift2_norm)

    tensors["x0.weight"] = layer.x0.double()
    a, b = _affine(layer.x0_norm)
    x1 = layer.x1.double()
    tensors["x1.weight"] = a.view(K, K, 1) * x1
    tensors["x1.bias"] = torch.einsum("ic,ico->co", b.view(K, K), x1)
    a, b = _affine(layer.x1_norm)
    after, shift = (t.view(K, K) for t in _affine(layer.x2_norm))
    x2 = layer.x2.double()
    tensors["x2.weight"] = a.view(K, K, 1) * x2 * after
    tensors["x2.bias"] = torch.einsum("ic,ico->co", b.view(K, K), x2) * after + shift

    tensors["depthwise.weight"] = layer.depthwise.double()
    tensors["pointwise.weight"] = layer.pointwise.double()
    tensors["pointwise.scale"], tensors["pointwise.shift"] = _affine(layer.norm)
    return tensors
