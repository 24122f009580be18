"""Trained networks to weights files, with batch norm folded away."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from segloc.descriptors.pointset import Alignment, save_weights
from segloc.types import Float32

from .models import DescriptorNetwork, Norm, XConv


def export(
    model: DescriptorNetwork,
    path: Path,
    card: Mapping[str, Any],
    alignment: Alignment = "pca2d",
    *,
    with_pairs: bool = False,
) -> None:
    """Write the weights file that inference reads.

    ``card`` says where the weights come from: data, command, figures, licence. ``with_pairs``: FC4
    goes with them.
    """
    pairs = model.pair_head.tensors() if with_pairs else {}
    arrays = {name: np.ascontiguousarray(tensor.numpy()) for name, tensor in pairs.items()}
    save_weights(path, {**folded(model), **arrays}, model.layers, alignment, card)


@torch.no_grad()
def folded(model: DescriptorNetwork) -> dict[str, Float32]:
    """The tensors of inference (cpp/network.h lists them).

    A batch norm becomes part of the next linear map where nothing lies between them; where the
    X-transform or the mean does, it stays as scale and shift. Computed in double.
    """
    tensors: dict[str, Tensor] = {}
    for index, layer in enumerate(model.xconvs):
        assert isinstance(layer, XConv)
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
    """Scale and shift of a batch norm at inference."""
    assert norm.running_mean is not None and norm.running_var is not None
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
