"""Plans are read alike from all formats; unit and up axis are as declared, or doubted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from samples.storey import storey

from segloc.errors import ConfigError, DatasetError
from segloc.tools.io.meshes import read_plan
from segloc.types import Float64

trimesh = pytest.importorskip("trimesh")
PLAN = storey(3)
Y_UP = (".glb", ".gltf", ".obj")


def written(folder: Path, suffix: str, plan: Float64 = PLAN, *, y_up: bool | None = None) -> Path:
    """Write a plan; its y axis points up as is usual in the format."""
    if suffix in Y_UP if y_up is None else y_up:
        plan = np.stack([plan[..., 0], plan[..., 2], -plan[..., 1]], axis=-1)
    corners = plan.reshape(-1, 3)
    mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    path = folder / f"plan{suffix}"
    if suffix == ".gltf":
        for name, data in trimesh.Scene(mesh).export(file_type="gltf").items():
            (folder / (path.name if name.endswith(".gltf") else name)).write_bytes(data)
    else:
        mesh.export(path)
    return path


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".obj", ".stl", ".ply"])
def test_formats(suffix: str, tmp_path: Path) -> None:
    read = read_plan(written(tmp_path, suffix))
    assert read.shape == PLAN.shape
    np.testing.assert_allclose(
        np.sort(read.sum(axis=(1, 2))), np.sort(PLAN.sum(axis=(1, 2))), atol=1e-4
    )
    np.testing.assert_allclose(
        read.reshape(-1, 3).min(axis=0), PLAN.reshape(-1, 3).min(axis=0), atol=1e-4
    )
    np.testing.assert_allclose(
        read.reshape(-1, 3).max(axis=0), PLAN.reshape(-1, 3).max(axis=0), atol=1e-4
    )


def test_instances_of_a_scene_are_placed(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    cube = trimesh.creation.box((2.0, 2.0, 2.0))
    scene.add_geometry(cube, geom_name="cube")
    scene.graph.update(
        "other", matrix=np.diag([1.0, 1, 1, 1]) + np.eye(4, k=3) * 10, geometry="cube"
    )
    scene.export(tmp_path / "scene.glb")
    read = read_plan(tmp_path / "scene.glb")
    assert len(read) == 24
    np.testing.assert_allclose(np.ptp(read.reshape(-1, 3), axis=0), [12, 2, 2], atol=1e-6)


def test_units(tmp_path: Path) -> None:
    path = written(tmp_path, ".stl", PLAN / 0.3048)
    np.testing.assert_allclose(
        np.ptp(read_plan(path, unit="ft").reshape(-1, 3), axis=0)[0], 24.14, atol=1e-3
    )
    for factor in (1000.0, 0.001):
        with pytest.raises(DatasetError, match="pass --unit"):
            read_plan(written(tmp_path, ".ply", factor * PLAN))
    assert len(read_plan(written(tmp_path, ".ply", 0.001 * PLAN), unit="m"))


def test_up_axis(tmp_path: Path) -> None:
    path = written(tmp_path, ".stl", y_up=True)
    with pytest.raises(DatasetError, match="pass --up y"):
        read_plan(path)
    low = read_plan(path, up="y").reshape(-1, 3).min(axis=0)
    np.testing.assert_allclose(low, PLAN.reshape(-1, 3).min(axis=0), atol=1e-4)
    assert len(read_plan(path, up="z"))
    with pytest.raises(DatasetError, match="pass --up z"):
        read_plan(written(tmp_path, ".obj", y_up=False))


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".obj", ".stl", ".ply"])
def test_damaged_files_have_one_clear_error(suffix: str, tmp_path: Path) -> None:
    whole = written(tmp_path, suffix).read_bytes()
    path = tmp_path / f"damaged{suffix}"
    for data in (b"", b"\0" * 100, whole[: len(whole) // 3], b"solid " + b"x" * 300):
        path.write_bytes(data)
        try:
            read_plan(path)
        except DatasetError as error:
            assert str(error).startswith(f"{path}: ")
        else:  # text may be cut between two triangles
            assert suffix == ".obj" and data == whole[: len(whole) // 3]


def test_clouds_and_other_files_are_refused(tmp_path: Path) -> None:
    trimesh.PointCloud(np.random.default_rng(0).normal(0, 9, (50, 3))).export(
        tmp_path / "cloud.ply"
    )
    with pytest.raises(DatasetError, match="map from-cloud"):
        read_plan(tmp_path / "cloud.ply")
    with pytest.raises(DatasetError, match="no such file"):
        read_plan(tmp_path / "plan.glb")
    with pytest.raises(DatasetError, match="not a plan by its name"):
        read_plan(tmp_path / "plan.dwg")
    with pytest.raises(ConfigError, match="unit must be"):
        read_plan(tmp_path / "plan.stl", unit="yd")


def test_too_many_triangles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("segloc.tools.io.meshes.MAX_TRIANGLES", 10)
    with pytest.raises(DatasetError, match="leave out furniture"):
        read_plan(written(tmp_path, ".stl"))
