"""Every benchmark by its name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from segloc.errors import ConfigError

from .fps import fps
from .geometric import clustering, knn, pose
from .harness import Row, in_process
from .network import dsm_vs_esm, network
from .query import query
from .registration import icp
from .stream import stream, stream_os1_128, stream_vlp16

Benchmark = Callable[[int, int], Row]

BENCHMARKS: dict[str, Benchmark] = {
    "fps": fps,
    "network": network,
    "dsm_vs_esm": dsm_vs_esm,
    "clustering": clustering,
    "knn": knn,
    "pose": pose,
    "icp": icp,
    "query": query,
    "stream": stream,
    "stream_os1_128": stream_os1_128,
    "stream_vlp16": stream_vlp16,
}
"""Functions of (threads, repeats)."""


def run(names: Sequence[str], threads: Sequence[int], repeats: int) -> Iterator[Row]:
    """Run benchmarks one after another, each in a process of its own.

    Raises
    ------
    ConfigError
        If there is no benchmark of a name, or a number is below 1.
    """
    for name in names:
        if name not in BENCHMARKS:
            raise ConfigError(f"no benchmark {name!r}; there are {', '.join(BENCHMARKS)}")
    if repeats < 1 or min(threads, default=0) < 1:
        raise ConfigError("threads and repeats must be at least 1")
    return (
        in_process(count, BENCHMARKS[name], count, repeats) for name in names for count in threads
    )
