"""Whole bags: ROS 1, SQLite and MCAP, each with one small cloud and a pose."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

from common import Bench, fuzz, instrumented

with instrumented:
    import rosbags.highlevel
    import rosbags.typesys

    from segloc.tools.datasets import open_sequence
    from segloc.tools.datasets.ros import bag_messages, bags, pointcloud2
import numpy as np
from samples.bags import BagWriter

assert bag_messages and bags and pointcloud2
# Most of the time would go into the definitions of ROS's own messages, read anew for each bag.
rosbags.typesys.get_typestore = functools.cache(rosbags.typesys.get_typestore)
SUFFIXES = (".bag", ".mcap", ".db3")
bench = Bench("sequence")


def read(data: bytes) -> None:
    path = bench.file(f"last{SUFFIXES[data[0] % 3] if data else '.bag'}", data[1:])

    def work() -> None:
        recording = open_sequence(path)
        for i in range(min(2, len(recording))):
            assert np.isfinite(recording.scan(i).points).all()

    bench.run(path, work)


def seeds() -> list[bytes]:
    folder = Path(tempfile.mkdtemp(prefix="fuzz-seeds-"))
    found = []
    for number, kind in enumerate(("ros1", "mcap", "sqlite3")):
        writer = BagWriter(kind)
        writer.cloud("/p", 1.6e9, np.ones((2, 3)))
        path = writer.write(folder / kind)
        file = path if path.is_file() else next(path.glob("*.[dm][bc]*"))
        found.append(bytes([number]) + file.read_bytes())
    return found


if __name__ == "__main__":
    fuzz(read, seeds(), ("op=\\x02", "op=\\x07", "conn=", "bz2", "lz4", "zstd", "SQLite format 3"))
