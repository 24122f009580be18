"""Memory and time of a training step, DSM against ESM."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from segloc.descriptors.pointset import DSM_LAYERS, ESM_LAYERS, Layer
from segloc.errors import MissingDependency

from ...bench.harness import in_process, interleaved, optional
from ...bench.network import DIM, build, prepared_segments, random_tensors
from ...evaluation.study import Cell, Study, Table
from ...stages import rise_mb
from .workspace import Workspace

NAME = "memory"
BATCH = 64
PUBLISHED_LESS = 70
"""GPU memory of DSM less than that of ESM, as published [%]."""

_DESCRIBED, _REPEATS = 300, 3
_TEXT = """\
DSM is ESM with fewer points in its inner layers, and takes less memory for it: the paper reports \
70 % less of a GPU's for the same batch. What training keeps from the forward to the backward pass \
is counted tensor by tensor, so that figure is the same on every machine; the peak of the process \
and the time of a step are those of this one."""


def run(workspace: Workspace) -> Study:
    """Measure a training step of DSM and of ESM, each in a fresh process."""
    if optional("torch") is None:
        raise MissingDependency("torch", "lab", "measuring training")
    start = time.monotonic()
    works: dict[str, Callable[[Sequence[Layer]], float]] = {
        "kept for the backward pass, MB": saved_mb,
        "peak of the process, MB": training_peak_mb,
        "forward and backward, ms": step_ms,
        f"describing {_DESCRIBED} segments, peak, MB": inference_mb,
    }
    rows: list[tuple[Cell, ...]] = []
    with workspace.progress("Measuring memory") as update:
        for done, (name, work) in enumerate(works.items()):
            update(done, len(works))
            dsm, esm = (in_process(1, work, layers) for layers in (DSM_LAYERS, ESM_LAYERS))
            less = round(100 * (1 - dsm / esm), 1) if esm > 0 else None
            rows.append((name, round(dsm, 1), round(esm, 1), less))
    facts = workspace.facts(time.monotonic() - start, {})
    tables = (_table(rows), _published())
    return Study(NAME, "Memory of training", tables, (), facts, _TEXT)


def _table(rows: list[tuple[Cell, ...]]) -> Table:
    columns = ("", "DSM", "ESM", "less, %")
    note = (
        f"A batch of {BATCH} segments in single precision, one thread. The layers of both are read "
        "from the paper's parameter counts: of ESM it does not say how many points each layer "
        "keeps, and here the first two keep all 256."
    )
    return Table("memory", "DSM against ESM", columns, tuple(rows), note)


def _published() -> Table:
    row = ("memory of a GPU, the same batch", None, None, PUBLISHED_LESS)
    return Table("memory-paper", "DSM against ESM", ("", "DSM", "ESM", "less, %"), (row,),
                 "Section Runtime; without absolute figures.", "paper")  # fmt: skip


def inference_mb(layers: Sequence[Layer]) -> float:
    """Return the peak memory of describing segments, beyond segments and weights."""
    prepared = prepared_segments(_DESCRIBED)
    engine = build(layers, random_tensors(layers))
    return rise_mb(lambda: engine.describe(prepared, 1))


def saved_mb(layers: Sequence[Layer]) -> float:
    """Return the activations that PyTorch keeps for the backward pass, each storage once."""
    torch, model, points = _training(layers)
    sizes: dict[int, int] = {}
    kept: list[Any] = []

    def pack(tensor: Any) -> Any:
        storage = tensor.untyped_storage()
        sizes[storage.data_ptr()] = storage.nbytes()
        kept.append(tensor)  # alive, so that no address is used twice
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor):
        model(points).square().sum().backward()
    weights = {p.untyped_storage().data_ptr() for p in model.parameters()}
    return sum(size for address, size in sizes.items() if address not in weights) / 1e6


def training_peak_mb(layers: Sequence[Layer]) -> float:
    """Return the peak memory of the process in one forward and backward pass."""
    _, model, points = _training(layers)
    return rise_mb(lambda: model(points).square().sum().backward())


def step_ms(layers: Sequence[Layer]) -> float:
    """Return the median time of a forward and backward pass on one thread [ms]."""
    torch, model, points = _training(layers)
    torch.set_num_threads(1)
    work = {"step": lambda: model(points).square().sum().backward()}
    return interleaved(work, 1, _REPEATS)["step"]


def _training(layers: Sequence[Layer]) -> tuple[Any, Any, Any]:
    from ...training.models import DescriptorNetwork

    found = optional("torch")
    assert found is not None
    torch = found[0]
    torch.manual_seed(0)
    model = DescriptorNetwork(layers, DIM).train()
    return torch, model, torch.from_numpy(prepared_segments(BATCH))
