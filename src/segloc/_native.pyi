from collections.abc import Mapping, Sequence
from typing import overload

import numpy as np
from numpy.typing import NDArray

__version__: str

def resolve_threads(threads: int) -> int: ...
def voxel_grid(points: NDArray[np.float32], size: float) -> NDArray[np.float32]: ...
def central_points(
    points: NDArray[np.float32], origin: NDArray[np.float64], voxel: float
) -> NDArray[np.float32]: ...
def heights_above_ground(
    points: NDArray[np.float32], cell: float, max_slope: float, outlier: float
) -> NDArray[np.float32]: ...
def euclidean_clusters(
    points: NDArray[np.float32], radius: float, min_points: int, max_points: int
) -> tuple[NDArray[np.uint32], NDArray[np.int64]]: ...
def split_by_height(
    points: NDArray[np.float32], heights: NDArray[np.float32], cut: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
def segments_above(
    points: NDArray[np.float32],
    heights: NDArray[np.float32],
    cuts: Sequence[float],
    radius: float,
    min_points: int,
    max_points: int,
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.float64], NDArray[np.float32]]: ...
def flat_normals(
    points: NDArray[np.float32],
    range: float,
    voxel_size: float,
    radius: float,
    min_points: int,
    thickness: float,
    most: int,
) -> NDArray[np.float32]: ...
def fit_vertical(
    normals: NDArray[np.float32], directions: NDArray[np.float64], tolerances: Sequence[float]
) -> NDArray[np.float64]: ...
def point_spacing(points: NDArray[np.float32], least: float, most: int) -> float: ...

class Agreement:
    def __init__(
        self,
        query: NDArray[np.float64],
        map: NDArray[np.float64],
        match_query: NDArray[np.int64],
        match_map: NDArray[np.int64],
        distinct_radius: float,
        inlier_tolerance: float,
        height_tolerance: float,
    ) -> None: ...
    def count(self, T_map_local: NDArray[np.float64]) -> int: ...

def consensus(
    query: NDArray[np.float64],
    map: NDArray[np.float64],
    match_query: NDArray[np.int64],
    match_map: NDArray[np.int64],
    inlier_tolerance: float,
    height_tolerance: float,
    distinct_radius: float,
    separation: float,
    separation_deg: float,
    max_refined: int,
    max_hypotheses: int,
    threads: int,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]: ...
def prosac(
    query: NDArray[np.float64],
    map: NDArray[np.float64],
    match_query: NDArray[np.int64],
    match_map: NDArray[np.int64],
    ordered: bool,
    edge_tolerance: float,
    inlier_tolerance: float,
    min_edge: float,
    chance: float,
    separation: float,
    separation_deg: float,
    max_draws: int,
    max_hypotheses: int,
    seed: int,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]: ...
def consistent_sets(
    query: NDArray[np.float64],
    map: NDArray[np.float64],
    match_query: NDArray[np.int64],
    match_map: NDArray[np.int64],
    objects: NDArray[np.int64],
    resolution: float,
    min_size: int,
    max_sets: int,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]: ...
def moved_crop(
    points: NDArray[np.float32], T: NDArray[np.float64], radius: float
) -> NDArray[np.float32]: ...

class VoxelWindow:
    def __init__(self, voxel_size: float, reach: float) -> None: ...
    def __len__(self) -> int: ...
    @property
    def voxels(self) -> int: ...
    @property
    def nbytes(self) -> int: ...
    def push(self, points: NDArray[np.float32], T_odom_sensor: NDArray[np.float64]) -> None: ...
    def drop(self, position: int) -> None: ...
    def move(self, T_odom_sensor: NDArray[np.float64]) -> None: ...
    def cloud(self, T_local_odom: NDArray[np.float64], radius: float) -> NDArray[np.float32]: ...

class VisibilityCheck:
    def __init__(
        self,
        structure: NDArray[np.float32],
        ground: NDArray[np.float32],
        range: float,
        bin_deg: float,
        radius: float,
    ) -> None: ...
    def count(
        self,
        points: NDArray[np.float32],
        T_local_map: NDArray[np.float64],
        radius: float,
        margin: float,
    ) -> tuple[int, int]: ...

def normals(
    points: NDArray[np.float32], max_correspondence_distance: float, support: float
) -> NDArray[np.float64]: ...

class MeshRays:
    def __init__(self, triangles: NDArray[np.float32]) -> None: ...
    def __len__(self) -> int: ...
    def cast(
        self,
        origins: NDArray[np.float32],
        directions: NDArray[np.float32],
        max_range: float,
        threads: int = 0,
    ) -> tuple[NDArray[np.float32], NDArray[np.int32]]: ...

class Surface:
    def __init__(
        self,
        points: NDArray[np.float32],
        max_correspondence_distance: float,
        support: float,
        tiled: bool = False,
    ) -> None: ...
    def __len__(self) -> int: ...
    def sampled(self, most: int) -> NDArray[np.float32]: ...
    def sampled_normals(self, most: int) -> NDArray[np.float64]: ...
    def off_plane(
        self,
        source: Surface,
        T_target_source: NDArray[np.float64],
        least_slope: float,
        most_slope: float,
        most: int,
    ) -> NDArray[np.float32]: ...
    def align(
        self,
        source: Surface,
        T_target_source: NDArray[np.float64],
        max_iterations: int = 20,
        threads: int = 0,
        max_final: int = 6,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float, int, int]: ...

class PointIndex:
    def __init__(self, points: NDArray[np.float32], radius: float) -> None: ...
    def __len__(self) -> int: ...
    def overlap(
        self,
        points: NDArray[np.float32],
        poses: NDArray[np.float64],
        radius: float,
        unmapped: float = 0.0,
    ) -> NDArray[np.float64]: ...
    def overlap_rmse(
        self,
        points: NDArray[np.float32],
        T_map_local: NDArray[np.float64],
        radius: float,
        unmapped: float = 0.0,
    ) -> tuple[float, float]: ...
    def correlate(
        self,
        points: NDArray[np.float32],
        T_map_local: NDArray[np.float64],
        headings: Sequence[float],
        cell: float,
        half_width: float,
        range: float,
    ) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]: ...
    def sample(
        self,
        x: float,
        y: float,
        radius: float,
        count: int,
        low: float = ...,
        high: float = ...,
    ) -> NDArray[np.float32]: ...

class KnownSpace:
    def __init__(
        self,
        index: PointIndex,
        viewpoints: NDArray[np.float64],
        range: float,
        bin_deg: float,
        margin: float,
    ) -> None: ...
    def codes(
        self, points: NDArray[np.float32], T_map_local: NDArray[np.float64], radius: float
    ) -> NDArray[np.uint8]: ...

def polar_images(
    cells: NDArray[np.float32],
    slices: NDArray[np.uint8],
    places: NDArray[np.float32],
    ring_m: float,
    rings: int,
    bands: int,
    sectors: int,
    threads: int = 0,
) -> NDArray[np.uint8]: ...

class PoseSearch:
    def __init__(
        self,
        points: NDArray[np.float32],
        slices: NDArray[np.uint8],
        roots: NDArray[np.int32],
        cell: float,
        levels: int,
        range: float,
    ) -> None: ...
    @property
    def nbytes(self) -> int: ...
    def search(
        self,
        columns: NDArray[np.float32],
        slices: NDArray[np.uint8],
        free: NDArray[np.float32],
        clearance: NDArray[np.uint8],
        yaws: int,
        leaf_level: int,
        width: int,
        count: int,
        separation: float,
        separation_deg: float,
        x: float = 0.0,
        y: float = 0.0,
        radius: float = ...,
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]: ...

def lzf_decompress(data: NDArray[np.uint8], size: int) -> NDArray[np.uint8]: ...
def octree_encode(cells: NDArray[np.int32], levels: int) -> NDArray[np.uint8]: ...
def octree_points(
    codes: NDArray[np.uint8],
    levels: int,
    count: int,
    parts: NDArray[np.uint8],
    bits: int,
    low: NDArray[np.int64],
    origin: NDArray[np.float64],
    voxel: float,
) -> NDArray[np.float32]: ...
def instruction_set(isa: str = "auto") -> str: ...
def fps(
    points: NDArray[np.float32], samples: int, threads: int = 0, isa: str = "auto"
) -> NDArray[np.int32]: ...
def prepare_segments(
    points: NDArray[np.float32],
    offsets: NDArray[np.int64],
    count: int = 256,
    alignment: str = "pca2d",
    threads: int = 0,
    isa: str = "auto",
) -> NDArray[np.float32]: ...
def dilated_neighbors(
    points: NDArray[np.float32],
    sources: int,
    queries: int,
    neighbors: int,
    dilation: int,
    threads: int = 0,
    isa: str = "auto",
) -> NDArray[np.int64]: ...
def shape_profiles(
    prepared: NDArray[np.float32], heights: NDArray[np.float32], threads: int = 0
) -> NDArray[np.float32]: ...
def knn(
    queries: NDArray[np.float32],
    database: NDArray[np.float32],
    k: int,
    threads: int = 0,
    isa: str = "auto",
) -> tuple[NDArray[np.int64], NDArray[np.float32]]: ...

class DescriptorIndex:
    @overload
    def __init__(
        self, database: NDArray[np.float32], lists: int, threads: int = 0, isa: str = "auto"
    ) -> None: ...
    @overload
    def __init__(
        self,
        codes: NDArray[np.uint8],
        base: NDArray[np.float32],
        step: NDArray[np.float32],
        lists: int,
        threads: int = 0,
        isa: str = "auto",
    ) -> None: ...
    def search(
        self, queries: NDArray[np.float32], k: int, probes: int, threads: int = 0
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]: ...
    def __len__(self) -> int: ...
    @property
    def lists(self) -> int: ...

def order_matches(
    query: NDArray[np.int64], map: NDArray[np.int64], score: NDArray[np.float32]
) -> NDArray[np.int64]: ...
def segment_moments(
    points: NDArray[np.float32], offsets: NDArray[np.int64], threads: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
def esf(
    points: NDArray[np.float32],
    offsets: NDArray[np.int64],
    triples: int = 20_000,
    seed: int = 0,
    threads: int = 0,
) -> NDArray[np.float32]: ...
def gestalt(
    points: NDArray[np.float32],
    offsets: NDArray[np.int64],
    radius: float = 5.0,
    threads: int = 0,
) -> NDArray[np.float32]: ...
def pair_features(
    query: NDArray[np.float32],
    mapped: NDArray[np.float32],
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    layout: tuple[int, bool, int],
    threads: int = 0,
) -> NDArray[np.float32]: ...

class Forest:
    def __init__(
        self,
        roots: NDArray[np.int32],
        feature: NDArray[np.int32],
        threshold: NDArray[np.float32],
        first_child: NDArray[np.int32],
        features: int,
    ) -> None: ...
    def predict(self, features: NDArray[np.float32], threads: int = 0) -> NDArray[np.float32]: ...
    def predict_pairs(
        self,
        query: NDArray[np.float32],
        mapped: NDArray[np.float32],
        rows: NDArray[np.int64],
        columns: NDArray[np.int64],
        layout: tuple[int, bool, int],
        threads: int = 0,
    ) -> NDArray[np.float32]: ...
    @property
    def features(self) -> int: ...

def voxel_shapes(
    points: NDArray[np.float32], offsets: NDArray[np.int64], threads: int = 0
) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.float32]]: ...

class VoxelNetwork:
    def __init__(self, tensors: dict[str, NDArray[np.float32]], isa: str = "auto") -> None: ...
    def describe(
        self,
        voxels: NDArray[np.int32],
        offsets: NDArray[np.int64],
        scales: NDArray[np.float32],
        threads: int = 0,
    ) -> NDArray[np.float32]: ...
    @property
    def dim(self) -> int: ...

def xconv_apply(
    x: NDArray[np.float32],
    lift: NDArray[np.float32],
    features: NDArray[np.float32],
    neighbors: NDArray[np.int64],
    depthwise: NDArray[np.float32],
    output: NDArray[np.float32],
    threads: int = 1,
    isa: str = "auto",
) -> None: ...
def xconv_apply_backward(
    x: NDArray[np.float32],
    lift: NDArray[np.float32],
    features: NDArray[np.float32],
    neighbors: NDArray[np.int64],
    depthwise: NDArray[np.float32],
    gradient: NDArray[np.float32],
    grad_x: NDArray[np.float32],
    grad_lift: NDArray[np.float32],
    grad_features: NDArray[np.float32],
    grad_depthwise: NDArray[np.float32],
    threads: int = 1,
    isa: str = "auto",
) -> None: ...
def column_maps(
    x: NDArray[np.float32],
    weight: NDArray[np.float32],
    output: NDArray[np.float32],
    threads: int = 1,
    isa: str = "auto",
) -> None: ...
def column_maps_backward(
    x: NDArray[np.float32],
    weight: NDArray[np.float32],
    gradient: NDArray[np.float32],
    grad_x: NDArray[np.float32],
    grad_weight: NDArray[np.float32],
    threads: int = 1,
    isa: str = "auto",
) -> None: ...
def elu_norm(
    input: NDArray[np.float32],
    activate: bool,
    weight: NDArray[np.float32],
    bias: NDArray[np.float32],
    eps: float,
    z: NDArray[np.float32],
    output: NDArray[np.float32],
    mean: NDArray[np.float32],
    variance: NDArray[np.float32],
    threads: int = 1,
    isa: str = "auto",
) -> None: ...
def elu_norm_backward(
    gradient: NDArray[np.float32],
    z: NDArray[np.float32],
    activate: bool,
    weight: NDArray[np.float32],
    eps: float,
    mean: NDArray[np.float32],
    variance: NDArray[np.float32],
    grad_input: NDArray[np.float32],
    grad_weight: NDArray[np.float32],
    grad_bias: NDArray[np.float32],
    threads: int = 1,
    isa: str = "auto",
) -> None: ...

class Network:
    def __init__(
        self,
        layers: list[tuple[int, int, int, int]],
        tensors: dict[str, NDArray[np.float32]],
        points: int = 256,
        isa: str = "auto",
    ) -> None: ...
    def describe(
        self, prepared: NDArray[np.float32], threads: int = 0
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
    def activations(self, prepared: NDArray[np.float32], layer: int) -> NDArray[np.float32]: ...
    @property
    def points(self) -> int: ...
    @property
    def dim(self) -> int: ...

class Perceptron:
    def __init__(
        self, tensors: Mapping[str, NDArray[np.float32]], limit: float, isa: str = "auto"
    ) -> None: ...
    def run(self, input: NDArray[np.float32], threads: int = 0) -> NDArray[np.float32]: ...
    @property
    def inputs(self) -> int: ...
    @property
    def outputs(self) -> int: ...
