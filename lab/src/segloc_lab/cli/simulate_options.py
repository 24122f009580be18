"""The options of ``segloc simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Scene = Annotated[
    str | None,
    typer.Argument(
        metavar="SCENE",
        help="town, park, meadow, forest, industrial, warehouse, offices, building or mine.",
        show_default="none: --suite",
    ),
]
Out = Annotated[
    Path, typer.Option(metavar="DIR", help="The folder to write to.", show_default=False)
]
Suite = Annotated[
    str | None,
    typer.Option(
        metavar="NAME", help="Instead of a scene: six named test sets.", show_default="none"
    ),
]
Scale = Annotated[str, typer.Option(metavar="NAME", help="Of a suite: small, full or paper.")]
Sensor = Annotated[str, typer.Option(metavar="NAME", help="What scans.")]
Thin = Annotated[int, typer.Option(metavar="COUNT", help="Only one of so many firings.")]
Platform = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="car, wheeled, legged, quadruped, carried, handheld or drone.",
        show_default="as the scene needs",
    ),
]
Tilt = Annotated[
    tuple[float, float],
    typer.Option(metavar="DEGREES DEGREES", help="Roll and pitch of the sensor on its platform."),
]
Skew = Annotated[bool, typer.Option(help="Let the sensor move while it scans.")]
Sessions = Annotated[
    int, typer.Option(min=1, max=1001, metavar="COUNT", help="Session 0 is the one to map.")
]
Length = Annotated[float, typer.Option(metavar="METRES", help="Of each session.")]
Spacing = Annotated[
    float | None,
    typer.Option(
        metavar="METRES", help="Between scans.", show_default="2, or 0.2 for one that sweeps"
    ),
]
Size = Annotated[
    float | None,
    typer.Option(metavar="METRES", help="Side of the world.", show_default="as the scene has it"),
]
Storey = Annotated[
    int, typer.Option(min=0, metavar="NUMBER", help="Of a building: which one is driven through.")
]
Seed = Annotated[int, typer.Option(min=0, metavar="NUMBER", help="Another seed is another world.")]
Season = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Of later sessions: summer, autumn, winter or spring.",
        show_default="as in session 0",
    ),
]
Foliage = Annotated[
    float | None,
    typer.Option(
        metavar="SHARE",
        help="Leaves left in later sessions, 0 to 1.",
        show_default="as the season has it",
    ),
]
Replaced = Annotated[
    float, typer.Option(metavar="SHARE", help="Of bins, benches, bushes and the like.")
]
Scaffolding = Annotated[float, typer.Option(metavar="SHARE", help="Of buildings with scaffolding.")]
Swathe = Annotated[
    float | None,
    typer.Option(
        metavar="METRES",
        help="Gather the sweeps of a push-broom LiDAR.",
        show_default="they stay apart",
    ),
]
FileFormat = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="SUFFIX",
        help="Of scans: npy, npz, laz, bin, pcd or ply.",
        show_default="npy, or npz with times",
    ),
]
Objects = Annotated[
    bool, typer.Option("--objects", help="Also write which object each point lies on.")
]
Workers = Annotated[int, typer.Option(min=1, metavar="COUNT", help="Processes that cast rays.")]
