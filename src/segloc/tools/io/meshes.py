"""Plans of buildings as triangles in metres with z up: glTF, OBJ, STL, PLY, and IFC by class."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ConfigError, DatasetError, requires
from ...types import Float64
from .fields import faults_of

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "in": 0.0254}
"""Metres per unit."""
UP_AXES = ("y", "z")
_UP = {".glb": "y", ".gltf": "y", ".obj": "y", ".stl": "z", ".ply": "z", ".ifc": "z"}
"""By format. That of glTF and IFC is part of the format; of others it is the usual one."""
_FIXED = (".glb", ".gltf", ".ifc")
"""Formats with a unit and an up axis of their own."""
SUFFIXES = tuple(_UP)
IFC_CLASSES = (
    "IfcWall",
    "IfcCurtainWall",
    "IfcSlab",
    "IfcRoof",
    "IfcCovering",
    "IfcColumn",
    "IfcBeam",
    "IfcStair",
    "IfcStairFlight",
    "IfcRamp",
    "IfcRampFlight",
)
"""What of an IFC file is read by default: what stays, and is not seen through."""
MAX_TRIANGLES = 20_000_000
_MIN_EXTENT_M, _MAX_EXTENT_M, _LOW = 2.0, 3000.0, 1 / 3


def read_plan(
    path: str | Path,
    *,
    unit: str | None = None,
    up: str | None = None,
    classes: Sequence[str] = IFC_CLASSES,
) -> Float64:
    """Read the triangles of a plan.

    Parameters
    ----------
    path : path
        GLB, glTF, OBJ, STL, PLY or IFC file.
    unit : str, optional
        Of :data:`UNITS`. By default metres; IFC files name their own.
    up : {"y", "z"}, optional
        Axis that points up; by default y of glTF and OBJ, and z of others.
    classes : sequence of str
        Classes of IFC that are read, with their subclasses.

    Returns
    -------
    (T, 3, 3) float64
        Corners in metres, z up.

    Raises
    ------
    DatasetError
        If the file is missing, malformed (names it), has no triangles or too many; or if it seems
        to have another unit or up axis than was assumed.
    MissingDependency
        If the format needs a package that is not installed.
    ConfigError
        If there is no such unit, axis or class.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if unit is not None and unit not in UNITS:
        raise ConfigError(f"unit must be one of {', '.join(UNITS)}, not {unit!r}")
    if up is not None and up not in UP_AXES:
        raise ConfigError(f"up must be one of {', '.join(UP_AXES)}, not {up!r}")
    if suffix not in _UP:
        raise DatasetError(f"{path}: not a plan by its name: {', '.join(SUFFIXES)}")
    if suffix == ".ifc" and unit is not None:
        raise ConfigError(f"{path}: IFC files name their unit: omit --unit")
    if not path.is_file():
        raise DatasetError(f"{path}: no such file")
    with faults_of(path):
        found = _of_ifc(path, classes) if suffix == ".ifc" else _of_mesh(path)
        if not len(found):
            raise DatasetError(
                "no triangles; of a point cloud, `segloc map from-cloud` makes a map"
            )
        found = found * UNITS[unit or "m"]
        axis = up or _UP[suffix]
        if axis == "y":
            found = np.stack([found[..., 0], -found[..., 2], found[..., 1]], axis=-1)
        _check(found, unit is None, up is None and suffix not in _FIXED, axis)
    return found


def _of_mesh(path: Path) -> Float64:
    """Return the triangles of a mesh or of a scene of meshes."""
    with requires("trimesh", "mesh", path.suffix):
        import trimesh
    materials = path.suffix.lower() in (".obj", ".ply")  # which name files of textures
    more: dict[str, Any] = {"skip_materials": True} if materials else {}
    try:
        scene = trimesh.load_scene(path, process=False, **more)
        sizes = {
            name: len(shape.faces) if hasattr(shape, "faces") else 0
            for name, shape in scene.geometry.items()
        }
        _check_count(sum(sizes[scene.graph[node][1]] for node in scene.graph.nodes_geometry))
        parts = [
            np.asarray(shape.triangles, dtype=np.float64)
            for shape in scene.dump()
            if len(getattr(shape, "faces", ()))
        ]
    except (DatasetError, MemoryError, OSError):
        raise
    except Exception as error:  # the library raises whatever its parsers meet
        raise DatasetError(f"cannot read the mesh: {error or type(error).__name__}") from error
    return np.concatenate([np.empty((0, 3, 3)), *parts])


def _of_ifc(path: Path, classes: Sequence[str]) -> Float64:
    """Return the triangles of some classes, openings cut out."""
    with requires("ifcopenshell", "ifc", ".ifc"):
        import ifcopenshell
        import ifcopenshell.geom
    try:
        model = ifcopenshell.open(str(path))
    except Exception as error:
        raise DatasetError(f"cannot read the IFC file: {error or type(error).__name__}") from error
    elements: dict[int, Any] = {}
    for name in classes:
        try:
            elements |= {each.id(): each for each in model.by_type(name)}
        except RuntimeError as error:
            raise ConfigError(f"{name!r} is no class of {model.schema}") from error
    if not elements:
        raise DatasetError(f"no element of the classes {', '.join(classes)}")
    settings = ifcopenshell.geom.settings()
    settings.set("use-world-coords", True)
    parts = list(
        _shapes(ifcopenshell.geom.iterator(settings, model, 1, include=[*elements.values()]))
    )
    _check_count(sum(map(len, parts)))
    return np.concatenate([np.empty((0, 3, 3)), *parts])


def _shapes(shapes: Any) -> Iterator[Float64]:
    """Yield the triangles of each element."""
    more = shapes.initialize()
    while more:
        geometry = shapes.get().geometry
        corners = np.array(geometry.verts, dtype=np.float64).reshape(-1, 3)
        yield corners[np.array(geometry.faces, dtype=np.int64).reshape(-1, 3)]
        more = shapes.next()


def _check_count(count: int) -> None:
    if count > MAX_TRIANGLES:
        raise DatasetError(
            f"{count / 1e6:.0f} million triangles, at most {MAX_TRIANGLES / 1e6:.0f}: leave out "
            "furniture, or simplify the mesh"
        )


def _check(triangles: Float64, unit_assumed: bool, up_assumed: bool, up: str) -> None:
    """Refuse a size that no building has, and one that lies on its side."""
    corners = triangles.reshape(-1, 3)
    corners = corners[np.isfinite(corners).all(axis=1)]
    if not len(corners):
        raise DatasetError("no triangle has finite corners")
    extent = np.ptp(corners, axis=0)
    largest = float(extent.max())
    if unit_assumed and not _MIN_EXTENT_M <= largest <= _MAX_EXTENT_M:
        raise DatasetError(
            f"the plan is {largest:.3g} m long, so its unit is probably not metres: pass --unit "
            f"({', '.join(UNITS)})"
        )
    if up_assumed and extent[:2].min() < _LOW * extent[2]:
        other = "z" if up == "y" else "y"
        raise DatasetError(
            f"with {up} up the plan is {extent[2]:.3g} m high and {extent[:2].min():.3g} m deep: "
            f"pass --up {other}, or --up {up} if that is right"
        )
