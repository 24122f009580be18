"""Files of scans: the first byte of an input chooses the suffix."""

from __future__ import annotations

from common import Bench, fuzz, instrumented

with instrumented:
    from segloc.tools.io import scans
import numpy as np
from samples import io as samples

SUFFIXES = tuple(scans._PARSERS)
bench = Bench("scan")


def read(data: bytes) -> None:
    suffix = SUFFIXES[data[0] % len(SUFFIXES)] if data else SUFFIXES[0]
    path = bench.file(f"last{suffix}", data[1:])

    def work() -> None:
        scan = scans._PARSERS[suffix](data[1:])
        assert np.isfinite(scan.points).all()
        assert scan.times is None or scan.times.shape == (len(scan),)

    bench.run(path, work)


SEEDS = [
    bytes([next(k for k, suffix in enumerate(SUFFIXES) if name.endswith(suffix))]) + data
    for name, data in samples.samples(samples.cloud(12)).items()
]
WORDS = (
    "FIELDS x y z", "SIZE 4", "TYPE F", "COUNT 1", "WIDTH", "HEIGHT", "POINTS", "DATA ascii",
    "DATA binary_compressed", "property list uchar int", "property float x", "element vertex",
    "element face", "end_header", "format ascii 1.0", "BINARY", "ASCII", "POINTS 9 float",
    "'descr': '<f4'", "'shape': (9, 3)", "nan", "1e999", "99999999999999999999",
)  # fmt: skip

if __name__ == "__main__":
    fuzz(read, SEEDS, WORDS)
