"""Exact Euclidean clusters against SciPy and scikit-learn.

``python benchmarks/bench_clustering.py [KITTI00]`` adds a real local cloud where the folder of
keyframes with its poses is given.
"""

import sys
from pathlib import Path

import numpy as np

from segloc import _native
from segloc.datasets import open_sequence
from segloc.local_cloud import Accumulator
from segloc.segmentation import SegmentationConfig
from segloc.types import Float32

from .geometric import clustering
from .harness import in_process
from .rows import main, show


def real_cloud(folder: Path) -> Float32:
    """What stands above ground within 50 m of 40 m of travel, voxelised at 0.2 m."""
    sequence = open_sequence(folder / "keyframes", Path("keyframes.tum"), "400:420")
    cloud = Accumulator().gather([sequence.scan(i) for i in range(len(sequence))])
    config = SegmentationConfig()
    points = _native.voxel_grid(cloud.points, config.accumulated.voxel_size)
    heights = _native.heights_above_ground(
        points, config.ground_cell, config.ground_slope, config.ground_step
    )
    return np.ascontiguousarray(points[heights > config.structure_height])


if __name__ == "__main__":
    main("clustering")
    if len(sys.argv) > 1:
        show([in_process(1, clustering, 1, 15, real_cloud(Path(sys.argv[1])))])
