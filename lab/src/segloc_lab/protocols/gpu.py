"""The networks on a GPU beside this package's own on the CPU, and a short training on both.

Segments are made by a program (random boxes, cylinders and walls), so no recording is needed. The
GPU runs the networks through the training framework; on the CPU they are the package's own.

    python -m segloc_lab.protocols.gpu --store docs/results
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from segloc.descriptors import create
from segloc.errors import ConfigError, MissingDependency
from segloc.system.machine import processor
from segloc.types import Segments

from ..bench.harness import in_process, interleaved, optional
from ..results.store import Cell, Result
from ..script import show, storing
from ..studies.paper.gpu import GPU_METHODS, gpu_ms
from ..training.config import TrainConfig
from ..training.dataset import SegmentDataset
from ..training.shapes import shapes_dataset

COMMAND = "python -m segloc_lab.protocols.gpu --store docs/results"
VIEWS = 4
INFERENCE = ("method", "on", "prepare, ms", "describe, ms", "both, ms")
TRAINING = (
    "on",
    "products",
    "steps",
    "seconds",
    "steps a second",
    "AUC",
    "recall at 25",
    "peak, MB",
)


def own_ms(segments: Segments, method: str, threads: int, repeats: int) -> tuple[float, float]:
    """Median milliseconds to prepare and to describe the segments by the package's own network."""
    descriptor = create(method, threads)
    prepared = descriptor.prepare(segments)
    times = interleaved(
        {
            "prepare": lambda: descriptor.prepare(segments),
            "describe": lambda: descriptor.encode(prepared),
        },
        threads,
        repeats,
    )
    return times["prepare"], times["describe"]


def inference(count: int, repeats: int, device: str) -> Result:
    """Every network on one core, on all of them, and on the GPU."""
    segments = shapes_dataset(-(-count // VIEWS), VIEWS, 0).segments(np.arange(count))
    cores = os.cpu_count() or 1
    rows: list[tuple[Cell, ...]] = []
    for method in GPU_METHODS:
        for threads in sorted({1, cores}):
            times = in_process(threads, own_ms, segments, method, threads, repeats)
            rows.append((method, f"{threads} CPU core{'s' * (threads > 1)}", *_shown(times)))
    found = in_process(cores, gpu_ms, [segments], GPU_METHODS, repeats, device)
    for method, times in found["times"].items():
        rows.append((method, found["device"], *_shown(times)))
    note = (
        f"{count} segments, made by a program; medians of {repeats} runs. {processor()}; "
        f"{_versions(found['device'])}. GPU: PyTorch in single precision with random weights, "
        "neighbours found on the CPU (in preparation), copies there and back in description. "
        "CPU: this package's own kernels, processor time on one core and the wall's on several."
    )
    rows.sort(key=lambda cells: GPU_METHODS.index(str(cells[0])))
    return Result.measured(
        "gpu-inference", COMMAND, INFERENCE, rows, stages=("descriptors",), methods=("esm", "dsm"),
        note=note,
    )  # fmt: skip


def _shown(times: Sequence[float]) -> tuple[float, ...]:
    prepare, describe = times
    return round(prepare, 2), round(describe, 2), round(prepare + describe, 2)


@dataclass
class Steps:
    """How far a training came, read from its remarks."""

    at: list[tuple[int, float]] = field(default_factory=list)

    def __call__(self, remark: str) -> None:
        if found := re.match(r"step (\d+) ", remark):
            self.at.append((int(found[1]), time.monotonic()))


def trained(dataset: SegmentDataset, config: TrainConfig) -> tuple[Cell, ...]:
    """A training of so many minutes or steps, as a row of the table."""
    import torch

    from ..training.train import train

    steps = Steps()
    with TemporaryDirectory() as folder:
        start = time.monotonic()
        scores = train(dataset, Path(folder) / "out.safetensors", config, progress=steps)
    count, end = steps.at[-1]
    name, peak = f"{config.threads} CPU cores", None
    if config.device == "cuda":
        name, peak = torch.cuda.get_device_name(), round(torch.cuda.max_memory_allocated() / 1e6)
    seconds = end - start
    figures = (count, round(seconds, 1), round(count / seconds, 1))
    quality = (round(scores.auc, 4), round(scores.recall, 4))
    return name, config.precision, *figures, *quality, peak


def training(objects: int, seconds: float, device: str) -> Result:
    """DSM for a while on the CPU in single precision, and on the GPU in both."""
    dataset, cores = shapes_dataset(objects, VIEWS, 0), os.cpu_count() or 1
    runs = [("cpu", "float32", seconds / 4)]
    if device == "cuda":
        runs += [("cuda", "float32", seconds / 4), ("cuda", "bfloat16", seconds)]
    rows: list[tuple[Cell, ...]] = []
    for on, precision, limit in runs:
        config = TrainConfig.model_validate(
            {
                "network": "dsm",
                "device": on,
                "precision": precision,
                "max_minutes": limit / 60,
                "threads": cores,
                "mine_objects": max(100, objects),
                "pair_weight": 0.0,
                "validation_limit": 1000,
            }
        )
        rows.append(in_process(cores, trained, dataset, config))
    note = (
        f"DSM on {objects} objects of {VIEWS} views each, made by a program, batches of 64 "
        f"segments; {cores} cores make the batches. bfloat16: autocast. Validation, on the CPU, is "
        "part of the seconds; runs of different length do not compare in AUC and recall. Peak: of "
        f"the GPU's memory. {processor()}; {_versions(str(rows[-1][0]))}."
    )
    return Result.measured(
        "gpu-training", COMMAND, TRAINING, rows, stages=("descriptors", "training"), note=note
    )


def _versions(device: str) -> str:
    found = optional("torch")
    return f"{device}, PyTorch {found[0].__version__}" if found else device


def main() -> None:
    options = storing(__doc__)
    options.add_argument("--segments", type=int, default=300, help="of a query")
    options.add_argument("--repeats", type=int, default=9)
    options.add_argument("--objects", type=int, default=3000, help="trained on")
    options.add_argument("--seconds", type=float, default=45.0, help="of the longest training")
    options.add_argument("--device", choices=("cuda", "cpu"), default="cuda")
    args = options.parse_args()
    found = optional("torch")
    if found is None:
        raise MissingDependency("torch", "train", "a GPU")
    if args.device == "cuda" and not found[0].cuda.is_available():
        raise ConfigError("there is no GPU here; --device cpu tries this script out")
    for result in (
        inference(args.segments, args.repeats, args.device),
        training(args.objects, args.seconds, args.device),
    ):
        show(result.columns, result.rows)
        print(f"\n{result.note}\n", flush=True)
        if args.store:
            result.save(args.store)


if __name__ == "__main__":
    main()
