"""The operations that training on a CPU spends its time on, as autograd functions.

Each has a native form for float32 on the CPU and the same in torch for other devices and types.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from segloc import _native

_NATIVE = ContextVar("native", default=True)


@contextmanager
def torch_forms() -> Iterator[None]:
    """Every operation in its torch form, on the CPU too: to export a network, or to compare it."""
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
    """Batch norm over the columns of (R, C), after ELU where ``activate`` is set.

    Returns
    -------
    output : (R, C)
    mean, variance : (C,)
        Of the batch; the variance is biased. Without gradient.
    """
    if _is_native(x, weight, bias):
        result: tuple[Tensor, Tensor, Tensor] = _EluNorm.apply(x, weight, bias, eps, activate)
        return result
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
        _native.elu_norm(
            _array(x),
            activate,
            _array(weight),
            _array(bias),
            eps,
            _array(z),
            _array(output),
            _array(mean),
            _array(variance),
            torch.get_num_threads(),
        )
        ctx.save_for_backward(z, weight, mean, variance)
        ctx.eps, ctx.activate = eps, activate
        ctx.mark_non_differentiable(mean, variance)
        return output, mean, variance

    @staticmethod
    def backward(ctx, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[no-untyped-def]
        z, weight, mean, variance = ctx.saved_tensors
        x, w, b = torch.empty_like(z), torch.empty_like(weight), torch.empty_like(weight)
        _native.elu_norm_backward(
            _array(gradients[0]),
            _array(z),
            ctx.activate,
            _array(weight),
            ctx.eps,
            _array(mean),
            _array(variance),
            _array(x),
            _array(w),
            _array(b),
            torch.get_num_threads(),
        )
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
        Gathered by ``neighbors`` and put behind ``lift``.
    neighbors : (B, N, K) int64
    depthwise : (D, K, L + F)

    Returns
    -------
    (B, N, D, L + F)
    """
    if _is_native(x, lift, depthwise) and (features is None or _is_native(features)):
        held = lift.new_empty(len(lift), 1, 0) if features is None else features
        result: Tensor = _Apply.apply(x, lift, held, neighbors, depthwise)
        return result
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
        _native.xconv_apply(*arrays, threads=torch.get_num_threads())  # type: ignore[misc]
        ctx.save_for_backward(*inputs)
        return output

    @staticmethod
    def backward(ctx, gradient: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[no-untyped-def]
        inputs = ctx.saved_tensors
        x, lift, features, _, depthwise = results = [torch.empty_like(t) for t in inputs]
        arrays = [_array(t) for t in (*inputs, gradient, x, lift, features, depthwise)]
        threads = torch.get_num_threads()
        _native.xconv_apply_backward(*arrays, threads=threads)  # type: ignore[misc]
        results[3] = None
        return tuple(results)


def column_maps(x: Tensor, weight: Tensor) -> Tensor:
    """A depthwise map of matrices: row c of the result comes from column c.

    Parameters
    ----------
    x : (..., K, K)
    weight : (K, K, K)
        The result at (c, o) is the sum over i of x at (i, c) times the weight at (i, c, o).
    """
    if _is_native(x, weight):
        result: Tensor = _ColumnMaps.apply(x, weight)
        return result
    # Most of this matrix is zero, and yet one large product is faster than K small ones.
    K = len(weight)
    eye = torch.eye(K, dtype=weight.dtype, device=weight.device)
    diagonals = weight.transpose(1, 2).unsqueeze(-1) * eye  # as diag_embed, which ONNX has not
    matrix = diagonals.permute(0, 2, 3, 1).reshape(K * K, K * K)
    return (x.flatten(-2) @ matrix.to(x.dtype)).view(x.shape)


class _ColumnMaps(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x: Tensor, weight: Tensor) -> Tensor:  # type: ignore[no-untyped-def]
        x, weight = x.contiguous(), weight.contiguous()
        K = len(weight)
        output = torch.empty_like(x)
        arrays = [_array(t) for t in (x.view(-1, K, K), weight, output)]
        _native.column_maps(*arrays, threads=torch.get_num_threads())  # type: ignore[misc]
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
        _native.column_maps_backward(*arrays, threads=threads)  # type: ignore[misc]
        return grad_x, grad_weight


def gather(values: Tensor, index: Tensor) -> Tensor:
    """values (B, S, C), index (B, N, K) -> (B, N, K, C)."""
    B, S, C = values.shape
    base = torch.arange(B, device=values.device).view(B, 1, 1) * S
    return values.reshape(B * S, C)[index + base]
