"""SegMap's grids against NumPy, its network against PyTorch, and its weights files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from samples.segments import objects, packed
from segloc_lab.training.writing import write_segmap

from segloc import _native, geometry
from segloc.descriptors import segmap
from segloc.descriptors.weightfile import read_weights, write_weights
from segloc.errors import WeightsError


def random_tensors(
    seed: int = 0, channels: tuple[int, int, int] = (32, 64, 64)
) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    a, b, c = channels
    shapes = {
        "conv1": (3, 3, 3, 1, a),
        "conv2": (3, 3, 3, a, b),
        "conv3": (3, 3, 3, b, c),
        "fc1": (256 * c + 3, 512),
        "fc2": (512, 64),
    }
    tensors = {}
    for name, shape in shapes.items():
        bound = math.sqrt(6 / math.prod(shape[:-1]))
        tensors[f"{name}.weight"] = rng.uniform(-bound, bound, shape).astype(np.float32)
        tensors[f"{name}.bias"] = rng.normal(0, 0.2, shape[-1]).astype(np.float32)
    return tensors


def test_grids_follow_their_definition() -> None:
    segments = packed([*objects(20), np.zeros((3, 3)), np.array([[4.0, 1, 2]])])
    shapes = segmap.prepare(segments, threads=1)
    grids = shapes.dense()
    size = np.array(segmap.GRID)
    for i in range(20):
        points = segments.segment(i).astype(np.float64)
        points -= points.mean(axis=0)
        cov = np.cov(points[:, :2].T)
        angle = 0.5 * math.atan2(2 * cov[0, 1], cov[0, 0] - cov[1, 1])
        points = geometry.transform(geometry.yaw_transform(-angle), points)
        y = points[:, 1]
        if 2 * (y < (y.min() + y.max()) / 2).sum() < len(y):
            points[:, :2] *= -1
        extent = np.maximum(np.ptp(points, axis=0), 0.1 * size)
        np.testing.assert_allclose(shapes.scales[i], extent, rtol=1e-4)
        voxels = np.floor(points / extent * size + size / 2).astype(int)
        voxels = voxels[((voxels >= 0) & (voxels < size)).all(axis=1)]
        expected = np.zeros(segmap.GRID, bool)
        expected[tuple(voxels.T)] = True
        # A point on a face between voxels may fall to either side.
        assert (expected != grids[i]).sum() <= 4
    assert grids[20].sum() == grids[21].sum() == 1
    np.testing.assert_allclose(shapes.scales[21], [3.2, 3.2, 1.6])


@pytest.mark.parametrize("isa", ["portable", "avx2", "avx512"])
def test_network_equals_torch(isa: str) -> None:
    torch = pytest.importorskip("torch")
    try:
        _native.instruction_set(isa)
    except ValueError:
        pytest.skip(f"this machine does not run {isa}")
    tensors = random_tensors()
    shapes = segmap.prepare(packed([*objects(9), np.zeros((1, 3))]), threads=1)
    ours = _native.VoxelNetwork(tensors, isa).describe(
        shapes.voxels, shapes.offsets, shapes.scales, threads=1
    )
    weights = {name: torch.from_numpy(tensor) for name, tensor in tensors.items()}
    x = torch.from_numpy(shapes.dense())[:, None]
    for k in (1, 2, 3):
        weight = weights[f"conv{k}.weight"].permute(4, 3, 0, 1, 2)
        x = torch.conv3d(x, weight, weights[f"conv{k}.bias"], padding=1).relu()
        x = torch.max_pool3d(x, 2) if k < 3 else x
    x = torch.cat([x.permute(0, 2, 3, 4, 1).flatten(1), torch.from_numpy(shapes.scales)], 1)
    for k in (1, 2):
        x = (x @ weights[f"fc{k}.weight"] + weights[f"fc{k}.bias"]).relu()
    np.testing.assert_allclose(ours, x.numpy(), rtol=1e-4, atol=1e-5 * float(x.max()))


def test_files_keep_the_network_but_for_eight_bits(tmp_path: Path) -> None:
    path, tensors = tmp_path / "w.safetensors", random_tensors()
    write_segmap(path, tensors, {"data": "none"})
    assert path.stat().st_size < 10_000_000
    descriptor = segmap.SegMapDescriptor(path, threads=1)
    assert descriptor.dim == 64 and descriptor.card == {"data": "none"}
    segments = packed([*objects(30)])
    shapes = descriptor.prepare(segments)
    full = _native.VoxelNetwork(tensors).describe(shapes.voxels, shapes.offsets, shapes.scales)
    stored = descriptor.describe(segments).vectors
    apart = np.linalg.norm(full[:, None] - full[None], axis=2)[np.triu_indices(30, 1)]
    assert np.linalg.norm(stored - full, axis=1).max() < 0.02 * np.median(apart)


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    write_segmap(path, random_tensors(0, (32, 32, 32)), {})
    kind, stored = (
        "voxel network",
        read_weights(path, "voxel network", {"fc1.weight": np.int8}).tensors,
    )
    settings = {"preprocessing": "1"}

    def refused(fault: str, kind: str = kind, version: str = "1", **changes: np.ndarray) -> None:
        changed = {name.replace("_", "."): tensor for name, tensor in changes.items()}
        write_weights(path, kind, {**stored, **changed}, {**settings, "preprocessing": version}, {})
        with pytest.raises(WeightsError, match=fault) as error:
            segmap.load_weights(path)
        assert str(path) in str(error.value)

    refused("not a voxel network", kind="network")
    refused("another preparation", version="2")
    refused("float64", fc2_bias=np.zeros(64))
    refused("expected int8", fc1_weight=stored["fc1.weight"].astype(np.float32))
    refused("not finite", fc2_bias=np.full(64, np.nan, np.float32))
    refused("fc2.bias", fc2_bias=np.zeros(32, np.float32))
    refused("ten tensors", fc3_bias=np.zeros(32, np.float32))
    del stored["fc1.weight.scale"]
    refused("'fc1.weight.scale' is missing")
