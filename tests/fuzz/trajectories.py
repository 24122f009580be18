"""Files of poses, and tables of datasets with poses."""

from __future__ import annotations

from common import Bench, fuzz, instrumented

with instrumented:
    from segloc.tools.datasets import tracks
    from segloc.tools.datasets.loaders import boreas, helipr, mulran, nclt, newer_college, robotcar
    from segloc.tools.io.pose_files import read_trajectory
import numpy as np

poses, tables = Bench("trajectory"), Bench("table")
READERS = (mulran._track, nclt._track, boreas._track, helipr._track, newer_college._track,
           robotcar._track)  # fmt: skip


def read(data: bytes) -> None:
    which = data[0] % (2 + len(READERS)) if data else 0
    if which == 0:
        path = poses.file("last.tum", data[1:])
        poses.run(path, lambda: read_trajectory(path))
        return
    path = tables.file("last.csv", data[1:])
    if which == 1:
        numbers = np.arange(3)
        tables.run(path, lambda: tracks.read_track(path, numbers, numbers * 0.1))
    else:
        tables.run(path, lambda: READERS[which - 2](path, "last.csv"))


TUM = b"".join(b"%d.5 %d 0 0 0 0 0 1\n" % (k, k) for k in range(4))
KITTI = b"1 0 0 5 0 1 0 6 0 0 1 7\n" * 3
INS = (b"timestamp,ins_status,northing,easting,down,roll,pitch,yaw\n"
       b"1,INS_SOLUTION_GOOD,1,2,3,0,0,0\n2,INS_INACTIVE,1,2,3,0,0,0\n")  # fmt: skip
VO = (b"source_timestamp,destination_timestamp,x,y,z,roll,pitch,yaw\n"
      b"2,1,1,0,0,0,0,0\n3,2,1,0,0,0,0,0\n")  # fmt: skip
ROWS = {
    0: TUM, 1: KITTI, 2: b"1,1,0,0,5,0,1,0,6,0,0,1,7\n" * 2, 3: b"1,2,3,4,0,0,0\n2,2,3,4,0,0,0\n",
    4: b"t,x,y,z,a,b,c,r,p,y\n1,2,3,4,0,0,0,0,0,0\n", 5: b"1 2 3 4 0 0 0 1\n",
    6: b"1,2,3,4,5,0,0,0,1\n", 7: INS,
}  # fmt: skip
SEEDS = [bytes([which]) + rows for which, rows in ROWS.items()] + [b"\7" + VO]

if __name__ == "__main__":
    fuzz(read, SEEDS, ("nan", "inf", "1e12", "1e308", "#", ",", " ", "\\x0a", "-", "0.0"))
