"""The native operations of training against the same in torch, forwards and backwards."""

from __future__ import annotations

import numpy as np
import pytest

from segloc import _native

torch = pytest.importorskip("torch")

from segloc_lab.training.models import column_maps, elu_norm, gather, xconv_apply  # noqa: E402

torch.set_num_threads(1)


def gradients(value, inputs):  # type: ignore[no-untyped-def]
    weight = torch.linspace(-1.0, 2.0, value.numel(), dtype=value.dtype).view(value.shape)
    return torch.autograd.grad((value * weight).sum(), [t for t in inputs if t.requires_grad])


def leaves(*shapes: tuple[int, ...]) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
    """The same random tensors in single and in double precision."""
    torch.manual_seed(sum(map(sum, shapes)))
    double = [torch.randn(*shape, dtype=torch.float64) for shape in shapes]
    return [t.float().requires_grad_() for t in double], [t.requires_grad_() for t in double]


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(37, 8), (50, 100), (300, 144), (2, 1)])
@pytest.mark.parametrize("activate", [True, False])
def test_elu_norm(shape: tuple[int, int], activate: bool) -> None:
    single, double = leaves(shape, shape[1:], shape[1:])
    ours, *moments = elu_norm(*single, 1e-3, activate)
    theirs, *expected = elu_norm(*double, 1e-3, activate)  # double: torch's own
    torch.testing.assert_close(ours.double(), theirs, rtol=1e-4, atol=1e-5)
    for a, b in zip(moments, expected, strict=True):
        torch.testing.assert_close(a.double(), b.double(), rtol=1e-4, atol=1e-5)
    for a, b in zip(gradients(ours, single), gradients(theirs, double), strict=True):
        scale = float(b.abs().max()) + 1e-3
        torch.testing.assert_close(a.double() / scale, b / scale, rtol=0, atol=3e-4)


@pytest.mark.parametrize(
    ("K", "lifted", "inputs", "depth"),
    [(8, 16, 0, 4), (10, 8, 32, 2), (3, 5, 1, 1)],
)
def test_xconv_apply(K: int, lifted: int, inputs: int, depth: int) -> None:
    B, N, S = 5, 6, 20
    index = torch.randint(0, S, (B, N, K))
    shapes = [(B, N, K, K), (B, N, K, lifted), (depth, K, lifted + inputs)]
    single, double = leaves(*shapes, *([(B, S, inputs)] if inputs else []))

    def run(tensors: list[torch.Tensor]) -> torch.Tensor:
        x, lift, depthwise, *features = tensors
        return xconv_apply(x, lift, features[0] if features else None, index, depthwise)

    ours, theirs = run(single), run(double)
    torch.testing.assert_close(ours.double(), theirs, rtol=1e-4, atol=1e-4)
    for a, b in zip(gradients(ours, single), gradients(theirs, double), strict=True):
        torch.testing.assert_close(a.double(), b, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("K", [1, 8, 17])
def test_column_maps(K: int) -> None:
    single, double = leaves((7, 11, K, K), (K, K, K))
    ours, theirs = column_maps(*single), column_maps(*double)
    expected = torch.einsum("bnic,ico->bnco", *double)
    torch.testing.assert_close(theirs, expected)
    torch.testing.assert_close(ours.double(), expected, rtol=1e-4, atol=1e-4)
    for a, b in zip(gradients(ours, single), gradients(expected, double), strict=True):
        torch.testing.assert_close(a.double(), b, rtol=1e-4, atol=1e-3)


def test_results_do_not_depend_on_threads() -> None:
    torch.manual_seed(0)
    results = []
    for threads in (1, 2):
        single, _ = leaves((9, 6, 4, 4), (9, 6, 4, 3), (2, 4, 7), (9, 11, 4))
        x, lift, depthwise, features = (t.detach().numpy() for t in single)
        index = np.random.default_rng(0).integers(0, 11, (9, 6, 4))
        grads = [np.empty_like(a) for a in (x, lift, features, depthwise)]
        gradient = np.linspace(-1, 1, 9 * 6 * 2 * 7, dtype=np.float32)
        _native.xconv_apply_backward(
            x, lift, features, index, depthwise, gradient, *grads, threads=threads
        )
        results.append(grads)
    for a, b in zip(*results, strict=True):
        np.testing.assert_array_equal(a, b)


def test_gather() -> None:
    values = torch.arange(24.0).view(2, 3, 4)
    index = torch.tensor([[[2, 0]], [[1, 1]]])
    assert torch.equal(gather(values, index)[1, 0, 0], values[1, 1])
    assert torch.equal(gather(values, index)[0, 0, 1], values[0, 0])
