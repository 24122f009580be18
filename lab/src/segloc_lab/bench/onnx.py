"""Networks in ONNX Runtime."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from segloc.types import Float32


def onnx_run(
    modules: tuple[Any, Any],
    model: Any,
    chunks: Sequence[tuple[Any, ...]],
    names: Sequence[str],
    threads: int,
    axes: Mapping[str, Mapping[int, str]] | None = None,
) -> Callable[[], Float32]:
    """A run of a PyTorch model over chunks of its inputs, exported to ONNX Runtime.

    Parameters
    ----------
    modules : (module, module)
        ``torch`` and ``onnxruntime``.
    model : torch.nn.Module
    chunks : sequence of tuple of Tensor
    names : sequence of str
        Of the inputs.
    threads : int
    axes : dict, optional
        Which axes of which input may change from chunk to chunk.
    """
    torch, runtime = modules
    file = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            model, chunks[0], file, input_names=list(names), dynamic_axes=axes, dynamo=False
        )
    options = runtime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    session = runtime.InferenceSession(file.getvalue(), options, providers=["CPUExecutionProvider"])
    feeds = [dict(zip(names, (t.numpy() for t in chunk), strict=True)) for chunk in chunks]
    return lambda: np.concatenate([session.run(None, feed)[0] for feed in feeds])
