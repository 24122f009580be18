"""Bags of layouts that are drawn from the bytes: topics, fields, sizes, files that are missing."""

from __future__ import annotations

import functools
import random

from common import Bench, fuzz, instrumented

with instrumented:
    import rosbags.typesys
    from hostile.opened import read_layout

    from segloc.tools.datasets.ros import bags

assert bags
rosbags.typesys.get_typestore = functools.cache(rosbags.typesys.get_typestore)
bench = Bench("layout")


def read(data: bytes) -> None:
    path = bench.file("last", data)
    bench.run(path, lambda: read_layout(path))


if __name__ == "__main__":
    fuzz(read, [random.Random(seed).randbytes(600) for seed in range(40)])
