"""Every method on the same query: 300 segments in a map of 10 000, stage by stage.

    python -m segloc_lab.bench.methods [--methods segmatch-eigen,nsm] [--map 10000]

Segments are shapes of `segloc_lab.training.shapes`, seen from several sides. SegMap's network is
also timed against PyTorch and ONNX Runtime.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from rich.progress import track

from segloc import Config, SegmentMap, _native
from segloc.descriptors import available, create, segmap
from segloc.proposals.matching import Matcher
from segloc.system.machine import processor
from segloc.types import Descriptors, Float32, Segments

from ..results.store import Cell, Result
from ..script import storing
from ..training.shapes import shapes_dataset
from .harness import OURS, Row, in_process, interleaved, optional, row
from .onnx import onnx_run
from .rows import rounded
from .stored import stored_network

COMMAND = "python -m segloc_lab.bench.methods"
COLUMNS = (
    *("method", "numbers", "threads", "prepare (ms)", "describe (ms)", "match (ms)", "prune (ms)"),
    *("kept of the candidates", "paper: describe, match, prune (ms)"),
)
VIEWS = 3
PAPER_MS = {  # Tinchev et al., table III, several cores: description, matching, pruning
    "segmatch-esf": (605, 50, 755),
    "nsm": (24, 207, 913),
    "segmap": (5902, 19, 0),
    "dsm": (184, 8, 0),
    "esm": (578, 8, 0),
}
CHUNK = 30


def main() -> None:
    parsed = storing(__doc__)
    parsed.add_argument("--methods", default=",".join(available()))
    parsed.add_argument("--query", type=int, default=300)
    parsed.add_argument("--map", type=int, default=10_000)
    parsed.add_argument("--threads", default="1,2")
    parsed.add_argument("--repeats", type=int, default=5)
    options = parsed.parse_args()
    methods = options.methods.split(",")
    threads = [int(count) for count in options.threads.split(",")]
    runs = [(method, count) for method in methods for count in threads]
    sizes = (options.query, options.map)
    rows = [
        in_process(count, measured, method, *sizes, count, options.repeats)
        for method, count in track(runs, "Timing methods")
    ]
    shown = f"--query {options.query} --map {options.map} --repeats {options.repeats}"
    command = f"{COMMAND} {shown} --store docs/results"
    note, stages = f"Machine: {processor()}.", ("descriptors", "matching")
    Result.measured(
        "methods-times", command, COLUMNS, rows, stages=stages, methods=methods, note=note
    ).tell(options.store)
    if "segmap" in methods:
        networks = [
            in_process(count, voxel_network, options.query, count, options.repeats)
            for count in threads
        ]
        stored_network(networks, command, processor()).tell(options.store)


def measured(method: str, query: int, size: int, threads: int, repeats: int) -> tuple[Cell, ...]:
    """One line of the table."""
    segments, descriptor = scene(query), create(method, threads)
    vectors = descriptor.describe(scene(size, seed=1)).vectors
    prior_map = SegmentMap.empty(method, descriptor.fingerprint, descriptor.dim)
    where = np.zeros((len(vectors), 3))
    ones = np.ones(len(vectors), np.int64)
    prior_map.add(Descriptors(vectors), where, ones, session=0, stamp=0.0, cloud=where[:0])
    config = Config.preset(method).matching
    matcher = Matcher(prior_map, config, pruner=descriptor.pruner, threads=threads)
    prepared = descriptor.prepare(segments)
    descriptors = descriptor.encode(prepared)
    candidates = matcher.match(descriptors)
    kept = matcher.prune(descriptors, candidates)
    runs: dict[str, Callable[[], object]] = {
        "preparation": lambda: descriptor.prepare(segments),
        "description": lambda: descriptor.encode(prepared),
        "matching": lambda: matcher.match(descriptors),
        "pruning": lambda: matcher.prune(descriptors, candidates),
    }
    times = interleaved(runs, threads, repeats)
    cells = (rounded(times[stage]) for stage in runs)
    paper = PAPER_MS.get(method)
    beside = None if paper is None else ", ".join(map(str, paper))
    pruned = f"{len(kept)} of {len(candidates)}"
    return method, descriptor.dim, threads, *cells, pruned, beside


def scene(count: int, seed: int = 0) -> Segments:
    """That many segments of 30 to some thousand points."""
    dataset = shapes_dataset(-(-count // VIEWS), VIEWS, seed)
    return dataset.segments(np.arange(count))


def voxel_network(count: int, threads: int, repeats: int) -> Row:
    """SegMap's network and its rivals."""
    tensors = voxel_tensors()
    network = _native.VoxelNetwork(tensors)
    shapes = segmap.prepare(scene(count), threads)
    runs: dict[str, Callable[[], np.ndarray]] = {
        OURS: lambda: network.describe(shapes.voxels, shapes.offsets, shapes.scales, threads)
    }
    modules = optional("torch", "onnxruntime", "onnx")
    if modules is not None:
        torch, runtime, _ = modules
        torch.set_num_threads(threads)
        model = torch_model(torch, tensors)
        chunks = list(
            zip(
                torch.split(torch.from_numpy(shapes.dense())[:, None], CHUNK),
                torch.split(torch.from_numpy(shapes.scales), CHUNK),
                strict=True,
            )
        )
        runs[f"torch, chunks of {CHUNK}"] = lambda: torch_run(torch, model, chunks)
        names = ("grids", "scales")
        axes = {name: {0: "segments"} for name in names}
        runs["onnxruntime"] = onnx_run((torch, runtime), model, chunks, names, threads, axes)
        for name, run in runs.items():
            error = float(np.abs(run() - runs[OURS]()).max())
            if error > 1e-3 * float(np.abs(runs[OURS]()).max()):
                raise RuntimeError(f"{name} differs by {error}")
    flops = 2.0 * count * (27 * (16384 * 32 + 2048 * 32 * 64 + 256 * 64 * 64) + 16387 * 512)
    skipped = () if modules is not None else ("torch", "onnxruntime")
    work = ("the dense convolutions", flops)
    return row("SegMap's network", threads, repeats, runs, flops=work, skipped=skipped)


def voxel_tensors(seed: int = 0) -> dict[str, Float32]:
    """Weights of SegMap's network, of the right shapes and sizes of value."""
    rng = np.random.default_rng(seed)
    shapes = {
        "conv1": (3, 3, 3, 1, 32),
        "conv2": (3, 3, 3, 32, 64),
        "conv3": (3, 3, 3, 64, 64),
        "fc1": (16387, 512),
        "fc2": (512, 64),
    }
    tensors = {}
    for name, shape in shapes.items():
        bound = np.sqrt(6 / np.prod(shape[:-1]))
        tensors[f"{name}.weight"] = rng.uniform(-bound, bound, shape).astype(np.float32)
        tensors[f"{name}.bias"] = np.full(shape[-1], 0.05, np.float32)
    return tensors


def torch_model(torch: Any, tensors: dict[str, np.ndarray]) -> Any:
    """The network in PyTorch, with the same weights."""
    nn, functional = torch.nn, torch.nn.functional

    class Model(nn.Module):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__()
            self.conv1, self.conv2, self.conv3 = (
                nn.Conv3d(*channels, 3, padding=1) for channels in ((1, 32), (32, 64), (64, 64))
            )
            self.fc1, self.fc2 = nn.Linear(16387, 512), nn.Linear(512, 64)
            for name, module in self.named_children():
                weight = torch.from_numpy(tensors[f"{name}.weight"])
                weight = weight.permute(4, 3, 0, 1, 2) if weight.ndim == 5 else weight.T
                module.weight = nn.Parameter(weight.contiguous())
                module.bias = nn.Parameter(torch.from_numpy(tensors[f"{name}.bias"]))

        def forward(self, grids: Any, scales: Any) -> Any:
            x = functional.max_pool3d(self.conv1(grids).relu(), 2)
            x = functional.max_pool3d(self.conv2(x).relu(), 2)
            x = self.conv3(x).relu().permute(0, 2, 3, 4, 1).flatten(1)
            return self.fc2(self.fc1(torch.cat([x, scales], 1)).relu()).relu()

    return Model().eval()


def torch_run(torch: Any, model: Any, chunks: list[tuple[Any, Any]]) -> Float32:
    with torch.inference_mode():
        described: Float32 = torch.cat([model(*chunk) for chunk in chunks]).numpy()
    return described


if __name__ == "__main__":
    main()
