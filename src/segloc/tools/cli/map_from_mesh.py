"""``segloc map from-mesh``"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import options
from .console import note, progress


def from_mesh(
    plan: Annotated[
        Path, typer.Argument(metavar="PLAN", help="GLB, glTF, OBJ, STL, PLY or IFC file.")
    ],
    out: options.MapOut,
    unit: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Unit: m, cm, mm, ft or in.", show_default="m; IFC: its own"
        ),
    ] = None,
    up: Annotated[
        str | None,
        typer.Option(
            metavar="AXIS", help="Axis that points up: y or z.", show_default="glTF, OBJ: y; else z"
        ),
    ] = None,
    tolerance: Annotated[
        float,
        typer.Option(metavar="METRES", help="How far the building may be off the plan."),
    ] = 0.05,
    sensor_height: Annotated[
        float,
        typer.Option(min=0.1, max=10, metavar="METRES", help="Height of viewpoints above floors."),
    ] = 1.0,
    ifc_class: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Class of IFC to read, such as IfcDoor; repeat for several.",
            show_default="walls, slabs, roofs, columns, beams, stairs, ramps",
        ),
    ] = None,
    method: options.Method = None,
    config: options.ConfigFile = None,
    weights: options.Weights = None,
    threads: options.Threads = 0,
) -> None:
    """Build a map from the plan of a building, without scans. Experimental.

    Scans are cast in the plan from its rooms and corridors, storey by storey, and mapped like a
    recording. The plan should have what stays: walls, floors, ceilings, columns, stairs; without
    furniture and glass. OBJ, STL, PLY and glTF need the extra `mesh`, IFC `ifc`.
    """
    from ...map.from_mesh import build_from_mesh
    from ...system.files import checked_target
    from ..io.meshes import IFC_CLASSES, read_plan
    from .map_info import save_and_show

    checked_target(out, ".segmap")
    settings = options.load_config(config, method, threads, weights)
    triangles = read_plan(plan, unit=unit, up=up, classes=ifc_class or IFC_CLASSES)
    with progress("Casting scans in the plan, and mapping them") as update:
        prior_map = build_from_mesh(
            triangles,
            settings,
            sensor_height=sensor_height,
            tolerance=tolerance,
            progress=update,
            note=note,
        )
    prior_map.metadata["sequence"] = plan.resolve().name
    save_and_show(prior_map, out, None)
