"""Selections of scans, and configurations in YAML."""

from __future__ import annotations

from common import Bench, fuzz, instrumented

with instrumented:
    from segloc import Config
    from segloc.tools.datasets.recorded import parse_select
import numpy as np

bench, selections = Bench("config"), Bench("selection")
NUMBERS = np.arange(9)


def read(data: bytes) -> None:
    text = data[1:].decode("utf-8", "replace")
    if data[:1] and data[0] % 2:
        path = selections.file("last.txt", data[1:])
        selections.run(path, lambda: str(parse_select(text).mask(NUMBERS)))
        return
    path = bench.file("last.yaml", data[1:])
    bench.run(path, lambda: Config.load(path))


SEEDS = [
    b"\1" + b"100:947,1001:,7", b"\0" + Config().explained().encode(),
    b"\0method: geo\nmapping: {views: [{length_m: 1.0}]}\nthreads: 2\n", b"\0seed: 2001-01-01\n",
]  # fmt: skip
WORDS = ("!!python/object", "!!int", "!!float", "!!timestamp", "!!binary", "!!set", "<<", "*a",
         ".inf", ".nan", "0x", "1:30", "method: ", "threads: ")  # fmt: skip

if __name__ == "__main__":
    fuzz(read, SEEDS, WORDS)
