"""What topics say, given to the core of the ROS 2 node: messages are drawn from the bytes."""

from __future__ import annotations

import random

from common import Bench, fuzz, instrumented

with instrumented:
    import segloc_ros.core
    from hostile.opened import heard_by_node

assert segloc_ros.core
bench = Bench("node")
MOST = 400
"""Bytes that are read: about fifty messages."""


def read(data: bytes) -> None:
    path = bench.file("last", data[:MOST])
    bench.run(path, lambda: heard_by_node(path))


if __name__ == "__main__":
    fuzz(read, [random.Random(seed).randbytes(MOST) for seed in range(40)])
