"""The benchmark *clustering* of ``segloc bench`` on a local cloud of KITTI 00.

python -m segloc_experiments.bench.real_clustering DATA
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from segloc import _native
from segloc.local_cloud import Accumulator
from segloc.segmentation import SegmentationConfig, heights_above_ground
from segloc.types import Float32

from ..kitti00 import keyframes
from ..script import parser
from .geometric import clustering
from .harness import in_process
from .rows import show

REPEATS = 15


def real_cloud(folder: Path) -> Float32:
    """What stands above ground within 50 m of 40 m of travel, voxelised at 0.2 m."""
    sequence = keyframes(folder, "400:420")
    cloud = Accumulator().gather([sequence.scan(i) for i in range(len(sequence))])
    config = SegmentationConfig()
    points = _native.voxel_grid(cloud.points, config.accumulated.voxel_size)
    heights = heights_above_ground(points, config)
    return np.ascontiguousarray(points[heights > config.structure_height])


def main() -> None:
    options = parser(__doc__)
    options.add_argument("data", type=Path)
    cloud = real_cloud(options.parse_args().data)
    show([in_process(1, clustering, 1, REPEATS, cloud)])


if __name__ == "__main__":
    main()
