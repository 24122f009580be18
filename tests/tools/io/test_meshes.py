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


def ifc(path: Path) -> None:
    """A wall of 8 x 0.2 x 3 m with a doorway and its door, a cupboard, and a space; millimetres."""
    ifcopenshell = pytest.importorskip("ifcopenshell")
    model = ifcopenshell.file(schema="IFC4")
    new = model.create_entity

    def placed(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> object:
        return new("IfcAxis2Placement3D", new("IfcCartesianPoint", (x, y, z)))

    unit = new("IfcSIUnit", None, "LENGTHUNIT", "MILLI", "METRE")
    context = new("IfcGeometricRepresentationContext", None, "Model", 3, 1e-5, placed())
    new("IfcProject", "0" * 22, Name="p", RepresentationContexts=[context], UnitsInContext=new(
        "IfcUnitAssignment", [unit]
    ))  # fmt: skip

    def element(kind: str, at: tuple[float, ...], size: tuple[float, ...]) -> object:
        middle = new("IfcAxis2Placement2D", new("IfcCartesianPoint", (size[0] / 2, size[1] / 2)))
        profile = new("IfcRectangleProfileDef", "AREA", None, middle, size[0], size[1])
        up = new("IfcDirection", (0.0, 0.0, 1.0))
        solid = new("IfcExtrudedAreaSolid", profile, placed(), up, size[2])
        shape = new("IfcShapeRepresentation", context, "Body", "SweptSolid", [solid])
        made = new("IfcProductDefinitionShape", None, None, [shape])
        name = f"{kind:_<22}"[:22]
        where = new("IfcLocalPlacement", None, placed(*at))
        return new(kind, name, ObjectPlacement=where, Representation=made)

    wall = element("IfcWallStandardCase", (0.0, 0.0, 0.0), (8000.0, 200.0, 3000.0))
    hole = element("IfcOpeningElement", (3000.0, -100.0, 0.0), (1000.0, 400.0, 2100.0))
    new("IfcRelVoidsElement", "1" * 22, RelatingBuildingElement=wall, RelatedOpeningElement=hole)
    element("IfcDoor", (3000.0, 0.0, 0.0), (1000.0, 50.0, 2100.0))
    element("IfcFurniture", (5000.0, 200.0, 0.0), (1000.0, 500.0, 2000.0))
    element("IfcSpace", (0.0, 200.0, 0.0), (8000.0, 5000.0, 3000.0))
    model.write(str(path))


def test_ifc_by_class(tmp_path: Path) -> None:
    path = tmp_path / "plan.ifc"
    ifc(path)
    wall = read_plan(path)
    np.testing.assert_allclose(np.ptp(wall.reshape(-1, 3), axis=0), [8, 0.2, 3], atol=1e-6)
    area = np.linalg.norm(np.cross(wall[:, 1] - wall[:, 0], wall[:, 2] - wall[:, 0]), axis=1) / 2
    assert area.sum() == pytest.approx(2 * (24 - 2.1) + 2 * 3 * 0.2 + 2 * 8 * 0.2 + 2 * 2.1 * 0.2)
    assert len(read_plan(path, classes=["IfcDoor"])) == 12
    assert len(read_plan(path, classes=["IfcWall", "IfcDoor"])) == len(wall) + 12
    with pytest.raises(ConfigError, match="'IfcChair' is no class of IFC4"):
        read_plan(path, classes=["IfcChair"])
    with pytest.raises(DatasetError, match="no element of the classes IfcColumn"):
        read_plan(path, classes=["IfcColumn"])
    with pytest.raises(ConfigError, match="omit --unit"):
        read_plan(path, unit="mm")


@pytest.mark.parametrize("data", [b"", b"ISO-10303-21;\nHEADER;", b"\0" * 100])
def test_damaged_ifc_files(data: bytes, tmp_path: Path) -> None:
    pytest.importorskip("ifcopenshell")
    (tmp_path / "plan.ifc").write_bytes(data)
    with pytest.raises(DatasetError, match=r"plan\.ifc: "):
        read_plan(tmp_path / "plan.ifc")
