"""Every function of the native module, ordinary arguments for it, and arguments to break it with.

``python -m samples.bindings NAME...`` calls them with each argument replaced, one at a time.
What a caller got wrong must come back as one line that names the argument, or as a finite answer.
A crash ends the process: run it as a child.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from segloc import _native
from segloc.descriptors.pointset import load_weights as load_pointset
from segloc.descriptors.segmap import load_weights as load_voxels
from segloc.descriptors.weightfile import read_weights, shipped_weights

Arguments = dict[str, Any]

HUGE = 2_000_000_000
FLOATS = (np.nan, np.inf, -np.inf, 0.0, -1.0, 5e-324, 1e-12, 1e9, 1e12, 1e30, 1e308, "1", None)
INTEGERS = (-1, 0, 1, 3, HUGE, 2**31, 2**32, 2**63 - 1, 2**63, 2**64 - 1, 2**64, 1.5, "1", None)
VALUES = (np.nan, np.inf, -np.inf, 1e30, -1e30, 3e14, -3e14, 5e-42)
ISA = ("", "avx1024", "portable", 1, None)


@dataclass(frozen=True)
class Call:
    """A function and arguments that it takes.

    ``free``: arguments whose values no answer can be spoiled by. ``answers``: whether the answer is
    finite by contract; training passes on what it is given, as PyTorch does.
    """

    function: Callable[..., Any]
    arguments: Arguments
    free: frozenset[str] = field(default_factory=frozenset)
    finite: bool = True


def _points(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.uniform(-8, 8, (count, 3)) * [1, 1, 0.3]).astype(np.float32)


def _offsets(count: int, parts: int) -> np.ndarray:
    return np.linspace(0, count, parts + 1).astype(np.int64)


def _matches(count: int = 60) -> Arguments:
    rng = np.random.default_rng(1)
    query = rng.uniform(-30, 30, (count, 3))
    index = np.arange(count, dtype=np.int64)
    return {
        "query": query,
        "map": query + [4.5e5, 5.4e6, 100.0],
        "match_query": index,
        "match_map": index.copy(),
    }


def _segments() -> Arguments:
    return {"points": _points(900), "offsets": _offsets(900, 5), "threads": 2}


def _segmentation() -> Iterator[tuple[str, Call]]:
    points = _points(600)
    yield "voxel_grid", Call(_native.voxel_grid, {"points": points, "size": 0.5})
    thinned = {"points": points, "origin": np.float64([0.1, 2.0, 0.3]), "voxel": 0.4}
    yield "central_points", Call(_native.central_points, thinned)
    ground = {"points": points, "cell": 0.7, "max_slope": 0.2, "outlier": 0.3}
    yield "heights_above_ground", Call(_native.heights_above_ground, ground)
    clusters = {"points": points, "radius": 0.5, "min_points": 2, "max_points": 500}
    yield "euclidean_clusters", Call(_native.euclidean_clusters, clusters)
    high = {"points": points, "heights": points[:, 2].copy()}
    yield "split_by_height", Call(_native.split_by_height, high | {"cut": 0.4})
    above = high | {"cuts": [0.6, 1.2], "radius": 0.5, "min_points": 2, "max_points": 500}
    yield "segments_above", Call(_native.segments_above, above)
    flat = {"points": points, "range": 30.0, "voxel_size": 0.1, "radius": 3.0, "min_points": 4}
    flat |= {"thickness": 0.5, "most": 300}
    yield "flat_normals", Call(_native.flat_normals, flat)
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    vertical = {"normals": axes.astype(np.float32), "directions": axes}
    vertical |= {"tolerances": [0.1, 0.05]}
    yield "fit_vertical", Call(_native.fit_vertical, vertical)
    spacing = {"points": points, "least": 0.1, "most": 128}
    yield "point_spacing", Call(_native.point_spacing, spacing)
    mesh = {"triangles": _points(300).reshape(100, 3, 3)}
    yield "MeshRays", Call(lambda **a: len(_native.MeshRays(**a)), mesh)
    rays = {"origins": _points(40), "directions": _points(40), "max_range": 50.0, "threads": 2}
    cast = _native.MeshRays(**mesh).cast
    # Rays that meet nothing have infinite ranges: that is an answer.
    yield "MeshRays.cast", Call(lambda **a: ~np.isinf(cast(**a)[0]), rays)


def _local_clouds() -> Iterator[tuple[str, Call]]:
    points, T = _points(600), np.eye(4)
    yield "moved_crop", Call(_native.moved_crop, {"points": points, "T": T, "radius": 20.0})
    build = {"voxel_size": 0.5, "reach": 30.0}
    yield "VoxelWindow", Call(_native.VoxelWindow, build)

    def called(name: str) -> Callable[..., Any]:
        """That method of a window of two scans, and then what the window shows."""

        def call(**arguments: Any) -> Any:
            window = _native.VoxelWindow(**build)
            window.push(points, T)
            window.push(points, T)
            answer = getattr(window, name)(**arguments)
            return answer, window.cloud(T, 20.0), len(window)

        return call

    yield "VoxelWindow.push", Call(called("push"), {"points": points, "T_odom_sensor": T})
    yield "VoxelWindow.drop", Call(called("drop"), {"position": 1})
    yield "VoxelWindow.move", Call(called("move"), {"T_odom_sensor": np.stack([T, T])})
    yield "VoxelWindow.cloud", Call(called("cloud"), {"T_local_odom": T, "radius": 20.0})


def _poses() -> Iterator[tuple[str, Call]]:
    consensus = _matches() | {
        "inlier_tolerance": 0.6,
        "height_tolerance": 1.0,
        "distinct_radius": 1.0,
        "separation": 3.0,
        "separation_deg": 15.0,
        "max_refined": 16,
        "max_hypotheses": 4,
        "threads": 2,
    }
    yield "consensus", Call(_native.consensus, consensus)
    prosac = _matches() | {
        "ordered": True,
        "edge_tolerance": 0.5,
        "inlier_tolerance": 0.6,
        "min_edge": 3.0,
        "chance": 0.01,
        "separation": 3.0,
        "separation_deg": 15.0,
        "max_draws": 1000,
        "max_hypotheses": 4,
        "seed": 0,
    }
    yield "prosac", Call(_native.prosac, prosac)
    matches = _matches()
    tolerance = {"inlier_tolerance": 0.6, "height_tolerance": 1.0}
    agreement = matches | {"distinct_radius": 0.5} | tolerance
    yield "Agreement", Call(lambda **a: _native.Agreement(**a).count(np.eye(4)), agreement)
    count = _native.Agreement(**agreement).count
    yield "Agreement.count", Call(count, {"T_map_local": np.eye(4)})
    consistency = matches | {"objects": np.arange(len(matches["query"]), dtype=np.int64)}
    consistency |= {"resolution": 0.4, "min_size": 4, "max_sets": 4}
    yield "consistent_sets", Call(_native.consistent_sets, consistency)


def _clouds() -> Iterator[tuple[str, Call]]:
    points, eye = _points(800), np.eye(4)
    index = _native.PointIndex(points, 1.0)
    yield "PointIndex", Call(_native.PointIndex, {"points": points, "radius": 1.0})
    overlap = {"points": points, "poses": np.stack([eye, eye]), "radius": 0.5}
    yield "PointIndex.overlap", Call(index.overlap, overlap)
    measured = {"points": points, "T_map_local": eye, "radius": 0.5}
    # The root mean square of no distance is NaN by contract.
    yield "PointIndex.overlap_rmse", Call(lambda **a: index.overlap_rmse(**a)[0], measured)
    sample = {"x": 0.0, "y": 1.0, "radius": 5.0, "count": 100}
    yield "PointIndex.sample", Call(index.sample, sample)
    correlate = {"points": points, "T_map_local": eye, "headings": [0.0, 1.0]}
    correlate |= {"cell": 0.5, "half_width": 3.0, "range": 20.0}
    yield "PointIndex.correlate", Call(index.correlate, correlate)
    known = {"viewpoints": np.zeros((2, 3)), "range": 20.0, "bin_deg": 2.0, "margin": 0.7}
    yield "KnownSpace", Call(lambda **a: _native.KnownSpace(index, **a), known)
    codes = {"points": points, "T_map_local": eye, "radius": 0.5}
    yield "KnownSpace.codes", Call(_native.KnownSpace(index, **known).codes, codes)
    view = {"structure": points, "ground": points, "range": 30.0, "bin_deg": 1.0, "radius": 0.5}
    yield "VisibilityCheck", Call(_native.VisibilityCheck, view)
    count = {"points": points, "T_local_map": eye, "radius": 0.5, "margin": 1.0}
    yield "VisibilityCheck.count", Call(_native.VisibilityCheck(**view).count, count)
    surface = {"points": points, "max_correspondence_distance": 1.0, "support": 1.0}
    yield "normals", Call(_native.normals, surface)
    yield "Surface", Call(lambda **a: len(_native.Surface(**a)), surface)
    known = _native.Surface(**surface)
    align = {"source": known, "T_target_source": eye, "max_iterations": 5, "threads": 2}
    off_plane = {"source": known, "T_target_source": eye, "least_slope": -1.0, "most_slope": 2.0}
    off_plane |= {"most": 100}
    # Points without a surface near are infinitely far off: that is an answer.
    far = frozenset({"source"})
    yield "Surface.off_plane", Call(lambda **a: ~np.isinf(known.off_plane(**a)), off_plane, far)
    yield "Surface.align", Call(known.align, align, frozenset({"source"}))


def _occupancy() -> Iterator[tuple[str, Call]]:
    points, slices = _points(300), np.arange(300).astype(np.uint8)
    roots = np.mgrid[-1:2, -1:2].reshape(2, -1).T.astype(np.int32).copy()
    made = {"points": points, "slices": slices, "roots": roots}
    made |= {"cell": 0.5, "levels": 3, "range": 10.0}
    yield "PoseSearch", Call(_native.PoseSearch, made)
    images = {"cells": points[:, :2].copy(), "slices": slices, "places": points[:3, :2].copy()}
    images |= {"ring_m": 1.5, "rings": 4, "bands": 2, "sectors": 16, "threads": 2}
    yield "polar_images", Call(_native.polar_images, images)
    requested = {"columns": points[:40, :2].copy() / 2, "slices": slices[:40].copy(), "yaws": 12}
    requested |= {"free": points[40:60, :2].copy() / 2, "clearance": np.full(20, 2, np.uint8)}
    requested |= {
        "leaf_level": 1,
        "width": 50,
        "count": 4,
        "separation": 1.0,
        "separation_deg": 9.0,
    }
    yield "PoseSearch.search", Call(_native.PoseSearch(**made).search, requested)


def _descriptors() -> Iterator[tuple[str, Call]]:
    yield "segment_moments", Call(_native.segment_moments, _segments())
    esf = _segments() | {"triples": 500, "seed": 1}
    yield "esf", Call(_native.esf, esf)
    yield "gestalt", Call(_native.gestalt, _segments() | {"radius": 5.0})
    yield "voxel_shapes", Call(_native.voxel_shapes, _segments())
    prepare = _segments() | {"count": 64, "alignment": "pca3d", "isa": "auto"}
    yield "prepare_segments", Call(_native.prepare_segments, prepare)
    batch = _points(4 * 64).reshape(4, 64, 3)
    yield "fps", Call(_native.fps, {"points": batch, "samples": 16, "threads": 2, "isa": "auto"})
    near = {"sources": 64, "queries": 32, "neighbors": 4, "dilation": 2, "threads": 2}
    neighbors = {"points": batch, **near, "isa": "auto"}
    yield "dilated_neighbors", Call(_native.dilated_neighbors, neighbors)
    heights = np.ones(4, np.float32)
    profiles = {"prepared": _points(4 * 256).reshape(4, 256, 3), "heights": heights, "threads": 2}
    yield "shape_profiles", Call(_native.shape_profiles, profiles)


def _matching() -> Iterator[tuple[str, Call]]:
    rng = np.random.default_rng(2)
    queries, database = (rng.normal(size=(n, 8)).astype(np.float32) for n in (20, 200))
    knn = {"queries": queries, "database": database, "k": 7, "threads": 2, "isa": "auto"}
    yield "knn", Call(_native.knn, knn)
    build = {"database": database, "lists": 4, "threads": 2, "isa": "auto"}
    yield "DescriptorIndex", Call(_native.DescriptorIndex, build)
    index = _native.DescriptorIndex(**build)
    search = {"queries": queries, "k": 7, "probes": 2, "threads": 2}
    yield "DescriptorIndex.search", Call(index.search, search)
    rows, columns = (rng.integers(0, n, 50) for n in (20, 200))
    scores = {"query": rows, "map": columns, "score": rng.random(50, dtype=np.float32)}
    yield "order_matches", Call(_native.order_matches, scores, frozenset({"query", "map", "score"}))
    pairs = {"query": queries, "mapped": database, "rows": rows, "columns": columns}
    pairs |= {"layout": (4, True, 2), "threads": 2}
    yield "pair_features", Call(_native.pair_features, pairs)
    tree = {
        "roots": np.array([0], np.int32),
        "feature": np.array([0, 0, 0], np.int32),
        "threshold": np.array([0.5, 0.9, 0.1], np.float32),
        "first_child": np.array([1, -1, -1], np.int32),
        "features": 22,
    }
    yield "Forest", Call(_native.Forest, tree, frozenset({"threshold"}))
    forest = _native.Forest(**tree)
    seen = _native.pair_features(**pairs)
    free = frozenset({"features", "query", "mapped"})  # leaves are finite, wherever a pair ends
    yield "Forest.predict", Call(forest.predict, {"features": seen, "threads": 2}, free)
    yield "Forest.predict_pairs", Call(forest.predict_pairs, pairs, free)


def _networks() -> Iterator[tuple[str, Call]]:
    dense = np.ones((3, 2), np.float32)
    tensors = {"input.mean": dense[:, 0].copy(), "input.scale": dense[:, 0].copy()}
    tensors |= {"output.weight": dense, "output.bias": dense[0].copy()}
    build = {"tensors": tensors, "limit": 5.0, "isa": "auto"}
    yield "Perceptron", Call(_native.Perceptron, build)
    run = {"input": _points(40), "threads": 2}
    yield "Perceptron.run", Call(_native.Perceptron(**build).run, run)
    path = shipped_weights("dsm.safetensors")
    network = load_pointset(path).network
    prepared = {"prepared": _points(3 * 256).reshape(3, 256, 3)}
    yield "Network.describe", Call(network.describe, prepared | {"threads": 2})
    yield "Network.activations", Call(network.activations, prepared | {"layer": 0})
    file = read_weights(path, "network")
    table = [(160, 8, 1, 32), (96, 10, 2, 64), (16, 12, 3, 128), (4, 16, 1, 256)]
    own = {name: t for name, t in file.tensors.items() if not name.startswith("pair.")}
    build = {"layers": table, "tensors": own, "points": 256, "isa": "auto"}
    yield "Network", Call(_native.Network, build)
    voxels = load_voxels(shipped_weights("segmap.safetensors"))[0]
    shapes = _native.voxel_shapes(**_segments())
    described = dict(zip(("voxels", "offsets", "scales"), shapes, strict=True))
    yield "VoxelNetwork.describe", Call(voxels.describe, described | {"threads": 2})


def _training() -> Iterator[tuple[str, Call]]:
    rng = np.random.default_rng(3)

    def some(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(np.float32)

    apply = {
        "x": some(2, 5, 4, 4),
        "lift": some(2, 5, 4, 3),
        "features": some(2, 6, 7),
        "neighbors": rng.integers(0, 6, (2, 5, 4)),
        "depthwise": some(2, 4, 10),
        "output": some(2, 5, 2, 10),
        "threads": 2,
        "isa": "auto",
    }
    yield "xconv_apply", Call(_native.xconv_apply, apply, finite=False)
    back = {name: value for name, value in apply.items() if name != "output"}
    back |= {"gradient": some(2, 5, 2, 10)}
    back |= {f"grad_{n}": some(*apply[n].shape) for n in ("x", "lift", "features", "depthwise")}
    yield "xconv_apply_backward", Call(_native.xconv_apply_backward, back, finite=False)
    maps = {"x": some(9, 5, 5), "weight": some(5, 5, 5), "threads": 2, "isa": "auto"}
    forward = maps | {"output": some(9, 5, 5)}
    yield "column_maps", Call(_native.column_maps, forward, finite=False)
    back = maps | {"gradient": some(9, 5, 5), "grad_x": some(9, 5, 5), "grad_weight": some(5, 5, 5)}
    yield "column_maps_backward", Call(_native.column_maps_backward, back, finite=False)
    norm = {"activate": True, "weight": some(6), "eps": 1e-5, "z": some(30, 6)}
    norm |= {"mean": some(6), "variance": abs(some(6)), "threads": 2, "isa": "auto"}
    forward = norm | {"input": some(30, 6), "bias": some(6), "output": some(30, 6)}
    yield "elu_norm", Call(_native.elu_norm, forward, finite=False)
    back = norm | {"gradient": some(30, 6), "grad_input": some(30, 6)}
    back |= {"grad_weight": some(6), "grad_bias": some(6)}
    yield "elu_norm_backward", Call(_native.elu_norm_backward, back, finite=False)


def _others() -> Iterator[tuple[str, Call]]:
    packed = np.frombuffer(b"\x03abcd\x60\x03", np.uint8)
    yield "lzf_decompress", Call(_native.lzf_decompress, {"data": packed, "size": 9})
    cells = np.int32([[0, 1, 2], [3, 3, 3], [2, 0, 1]])
    yield "octree_encode", Call(_native.octree_encode, {"cells": cells, "levels": 2})
    tree = {
        **{"codes": _native.octree_encode(cells, 2), "levels": 2, "count": 3, "voxel": 0.3},
        **{"parts": np.uint8([129, 2]), "bits": 1, "low": np.arange(3), "origin": np.arange(3.0)},
    }
    yield "octree_points", Call(_native.octree_points, tree)
    yield "resolve_threads", Call(_native.resolve_threads, {"threads": 2})
    yield "instruction_set", Call(lambda isa: len(_native.instruction_set(isa)), {"isa": "auto"})


_TABLES = (
    *(_segmentation, _local_clouds, _poses, _clouds, _occupancy, _descriptors),
    *(_matching, _networks, _training, _others),
)
ROOMS: dict[Callable[[], Iterator[tuple[str, Call]]], tuple[str, ...]] = {
    table: tuple(re.findall(r'yield "([\w.]+)"', inspect.getsource(table))) for table in _TABLES
}
"""The names of each table, which are known before its arguments are made."""
NAMES = tuple(name for names in ROOMS.values() for name in names)

TOGETHER: dict[str, tuple[Arguments, ...]] = {
    "heights_above_ground": (
        {"points": np.float32([[1e14, 1, 0], [1.2e14, 2, 1]]), "cell": 0.3},
        {"points": np.float32([[6.4e6, 1, 0], [6.4e6, 2, 1]]), "cell": 1e-6},
        {"points": np.float32([[4.1e15, 4.1e15, 0], [4.2e15, 4.1e15, 0]]), "cell": 0.7},
        {"points": np.float32([[8e14, 8e14, 0], [-8e14, 8e14, 0]]), "cell": 1e9},
    ),
    "voxel_grid": (
        {"points": np.float32([[9e14, 9e14, 9e14], [-9e14, -9e14, -9e14]]), "size": 1e-6},
        {"points": np.float32([[9e14] * 3, [-9e14] * 3]), "size": 1e9},
    ),
    "consensus": (
        {"inlier_tolerance": 0.001, "distinct_radius": 0.0},
        {"query": np.zeros((60, 3))},
        {"query": np.full((60, 3), 9e14)},
        {"query": np.linspace(-9e14, 9e14, 180).reshape(60, 3)},
        {"map": np.linspace(-9e14, 9e14, 180).reshape(60, 3)},
        {
            "inlier_tolerance": 1e6,
            "separation": 0.0,
            "map": np.linspace(-1e8, 1e8, 180).reshape(60, 3),
        },
    ),
    "PointIndex.sample": ({"radius": 9e8, "count": 1}, {"x": 9e14, "radius": 1e9}),
    "DescriptorIndex.search": ({"k": 200, "probes": 2**63, "threads": HUGE},),
    "gestalt": ({"points": np.float32([[0, 0, 0]] * 900)}, {"radius": 1e-6}),
    "prepare_segments": ({"points": np.float32([[5e-42, 0, -5e-42]] * 900)},),
    "esf": ({"points": np.float32([[5e-42, 0, -5e-42]] * 900)},),
}
"""Arguments that only break things together."""


def calls(name: str) -> dict[str, Call]:
    """The function of that name and its neighbours."""
    return dict(next(room for room, names in ROOMS.items() if name in names)())


def _arrays(array: np.ndarray) -> Iterator[tuple[str, Any]]:
    """The same array in ways that are wrong, or only unusual."""
    is_float, values = array.dtype.kind == "f", VALUES
    if not is_float:
        limits = np.iinfo(array.dtype)
        every = (limits.min, -1, 0, 1, 10**6, limits.max)
        values = tuple(value for value in every if limits.min <= value <= limits.max)
    for value in values:
        one = array.copy()
        one.flat[one.size // 2] = value
        yield f"one value {value}", one
        yield f"all values {value}", np.full_like(array, value)
    if not is_float:
        yield "falling", array[::-1].copy()
    frozen = array.copy()
    frozen.flags.writeable = False
    yield "read-only", frozen
    yield "empty", array[:0].copy()
    yield "one row", array[:1].copy()
    yield "twice as long", np.concatenate([array, array])
    yield "no columns", np.empty((*array.shape[:-1], 0), array.dtype)
    yield "long and without columns", np.empty((2**40, *array.shape[1:-1], 0), array.dtype)
    yield "wide and without rows", np.empty((0, *array.shape[1:-1], 2**40), array.dtype)
    yield "another axis", array[None].copy()
    yield "flat", array.reshape(-1).copy()
    yield "no axis", array.reshape(-1)[0].copy()
    yield "four columns", np.ones((*array.shape[:-1], 4), array.dtype)
    yield "every second row", np.repeat(array, 2, axis=0)[::2]
    yield "by columns", np.asfortranarray(array)
    yield "backwards", array[::-1]
    for kind in ("float16", "float32", "float64", "int32", "int64", "complex128", "object", ">f4"):
        if np.dtype(kind) != array.dtype:
            yield kind, array.astype(kind)
    for value in (None, "points", [], [[0.0, 0.0, 0.0]], 1.0):
        yield repr(value), value


def _replacements(value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, np.ndarray):
        yield from _arrays(value)
    elif isinstance(value, dict):
        for name in value:
            yield f"without {name}", {n: v for n, v in value.items() if n != name}
            for text, wrong in _arrays(value[name]):
                yield f"{name} {text}", value | {name: wrong}
    elif isinstance(value, bool):
        yield from ((repr(v), v) for v in (True, False, None, 2))
    elif isinstance(value, int):
        yield from ((repr(v), v) for v in INTEGERS)
    elif isinstance(value, float):
        yield from ((repr(v), v) for v in FLOATS)
    elif isinstance(value, str):
        yield from ((repr(v), v) for v in ISA)
    elif isinstance(value, (tuple, list)):
        for wrong in (-1, 0, 1, 65536, 2**31 - 1, 2**63 - 1):
            for k in range(len(value)):
                if isinstance(value[k], bool):
                    continue
                inner = (wrong, *value[k][1:]) if isinstance(value[k], tuple) else wrong
                yield f"{wrong} at {k}", type(value)([*value[:k], inner, *value[k + 1 :]])
                if isinstance(value[k], tuple):
                    inner = (*value[k][:-1], wrong)
                    yield f"{wrong} last at {k}", [*value[:k], inner, *value[k + 1 :]]
        yield "nothing", type(value)()
    else:
        yield from ((repr(v), v) for v in (None, 1, "surface"))


def cases(name: str, call: Call) -> Iterator[tuple[str, str, Arguments]]:
    """What is wrong, with which argument, and all arguments."""
    yield "ordinary", "", dict(call.arguments)
    for argument, value in call.arguments.items():
        for text, wrong in _replacements(value):
            yield f"{argument}: {text}", argument, call.arguments | {argument: wrong}
    for several in TOGETHER.get(name, ()):
        yield f"together: {', '.join(several)}", "", call.arguments | several


def is_finite(answer: Any) -> bool:
    if isinstance(answer, (tuple, list)):
        return all(is_finite(part) for part in answer)
    if isinstance(answer, (np.ndarray, int, float)):
        return bool(np.isfinite(answer).all())
    return True  # an object or nothing


def check(call: Call, text: str, argument: str, arguments: Arguments) -> str:
    """The fault of one call, if it has any."""
    copied = {n: v.copy() if isinstance(v, np.ndarray) else v for n, v in arguments.items()}
    outputs = [n for n in copied if n in ("output", "z", "mean", "variance") or "grad_" in n]
    try:
        answer = call.function(**arguments)
    except TypeError:
        return ""
    except ValueError as error:
        lines = str(error)
        if "\n" in lines or not lines:
            return f"not one line: {lines!r}"
        if ("nan" in text or "inf" in text) and argument.rstrip("s") not in lines:
            return f"{lines!r} does not name {argument}"
        return ""
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    if call.finite and argument not in call.free and not is_finite(answer):
        return "the answer is not finite"
    for name, value in copied.items():
        if not isinstance(value, np.ndarray) or value.dtype == object or name in outputs:
            continue
        if value.tobytes() != arguments[name].tobytes():
            return f"{name} was changed"
    return ""


DONE = "DONE"


def main(names: list[str]) -> None:
    """A line before each call, and one for each fault; ``DONE`` and its name ends a function."""
    for name in names:
        call = calls(name)[name]
        if not is_finite(call.function(**call.arguments)):
            print(f"FAULT {name} ordinary: the answer is not finite", flush=True)
        for text, argument, arguments in cases(name, call):
            print(f"{name} {text}", flush=True)  # the last line names a crash
            if fault := check(call, text, argument, arguments):
                print(f"FAULT {name} {text}: {fault}", flush=True)
        print(DONE, name, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
