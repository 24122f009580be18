"""Every method on the same query: 300 segments in a map of 10 000, stage by stage.

    python -m segloc_lab.bench.methods [--methods segmatch-eigen,nsm] [--map 10000]

Segments are shapes of `segloc_lab.training.shapes`, seen from several sides.
"""

from collections.abc import Callable

import numpy as np
from rich.progress import track

from segloc import Config, SegmentMap
from segloc.descriptors import available, create
from segloc.proposals import Matcher
from segloc.types import Descriptors, Segments

from ..report import Cell, Table, publish, reporting
from ..training.shapes import shapes_dataset
from .harness import in_process, interleaved, rounded

COLUMNS = (
    "method",
    "numbers",
    "threads",
    "prepare (ms)",
    "describe (ms)",
    "match (ms)",
    "prune (ms)",
    "kept of the candidates",
    "paper: describe, match, prune (ms)",
)
VIEWS = 3
PAPER_MS = {  # Tinchev et al., table III, several cores: description, matching, pruning
    "segmatch-esf": (605, 50, 755),
    "nsm": (24, 207, 913),
    "segmap": (5902, 19, 0),
    "dsm": (184, 8, 0),
    "esm": (578, 8, 0),
}


def main() -> None:
    parsed = reporting(__doc__)
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
    publish(options.report, "Methods on segments, stage by stage", Table(COLUMNS, rows))


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


if __name__ == "__main__":
    main()
