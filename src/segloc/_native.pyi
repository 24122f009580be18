import numpy as np
from numpy.typing import NDArray

__version__: str

def resolve_threads(threads: int) -> int: ...
def voxel_grid(points: NDArray[np.float32], size: float) -> NDArray[np.float32]: ...
def heights_above_ground(
    points: NDArray[np.float32], cell: float, max_slope: float, outlier: float
) -> NDArray[np.float32]: ...
def euclidean_clusters(
    points: NDArray[np.float32], radius: float, min_points: int, max_points: int
) -> tuple[NDArray[np.uint32], NDArray[np.int64]]: ...
def pair_consensus(
    query: NDArray[np.float64],
    map: NDArray[np.float64],
    match_query: NDArray[np.int64],
    match_map: NDArray[np.int64],
    edge_tolerance: float,
    inlier_tolerance: float,
    height_tolerance: float,
    min_edge: float,
    distinct_radius: float,
    separation: float,
    max_pivots: int,
    max_hypotheses: int,
    threads: int,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]: ...
def prosac(
    query: NDArray[np.float64],
    map: NDArray[np.float64],
    match_query: NDArray[np.int64],
    match_map: NDArray[np.int64],
    ordered: bool,
    yaw_only: bool,
    edge_tolerance: float,
    inlier_tolerance: float,
    min_edge: float,
    chance: float,
    separation: float,
    max_draws: int,
    max_hypotheses: int,
    seed: int,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]: ...

class PointIndex:
    def __init__(self, points: NDArray[np.float32], radius: float) -> None: ...
    def __len__(self) -> int: ...
    def overlap(
        self, points: NDArray[np.float32], poses: NDArray[np.float64], radius: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
    def within(self, x: float, y: float, radius: float) -> NDArray[np.int64]: ...

def lzf_decompress(data: NDArray[np.uint8], size: int) -> NDArray[np.uint8]: ...
