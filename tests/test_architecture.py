"""The layers of the house, held to by reading the source.

A module may import what stands below its own layer. ``together`` says that the rooms of a layer may
import each other; others keep apart. Imports in functions and for types alone count like others.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from samples import source
from samples.source import PROJECT, ROOT, Length, Package

from segloc.cli.verbs import MAPS, ORDER


class Layer(NamedTuple):
    rooms: str
    together: bool = False


LAYERS = (
    Layer("__main__"),
    Layer("cli"),
    Layer(ROOT),
    Layer("batch alignment training live export explanation"),
    Layer("simulation diagnosis pictures sample"),
    Layer("datasets"),
    Layer("tracker scan_check hypotheses views", together=True),
    Layer("tiles"),
    Layer("localizer answer fallback search thin_vote", together=True),
    Layer("map.build map.sessions map.update", together=True),
    Layer("config"),
    Layer(
        "local_cloud scan_window rolling_cloud levelling segmentation matching pose "
        "consistency occupancy landmarks registration verification map",
        together=True,
    ),
    Layer("attitude mounting"),
    Layer("descriptors"),
    Layer("io"),
    Layer("motion processes reposed system files tensor_file stage_times yamlfile"),
    Layer("locks"),
    Layer(
        "georeference geometry types localization prior checks section errors budget _native",
        together=True,
    ),
)
"""Top to bottom. A room is a module or a package; the longest name that fits is a module's room."""

ONLY = {"datasets": "io motion files geometry types checks section errors budget _native"}
"""Rooms that may import no other than these: datasets stand beside the stages."""

PACKAGES = {
    "numpy": "*",
    "scipy": "*",
    "pydantic": "*",
    "torch": "training",
    "sklearn": "training",
    "safetensors": "descriptors map training",
    "yaml": "config yamlfile",
    "laspy": "io",
    "lazrs": "io",
    "rosbags": "datasets.ros",
    "lz4": "datasets.ros",
    "velodyne_decoder": "datasets.packets",
    "kiss_icp": "datasets.odometry",
    "embreex": "simulation",
    "matplotlib": "pictures batch explanation",
    "viser": "explanation",
    "fsspec": "tiles",
    "pyproj": "georeference",
    "distributed": "processes",
    "typer": "cli",
    "rich": "cli",
}
"""Where a package of others may be imported. None draws, knows ROS or trains below the datasets."""

BY_NAME = {
    *("descriptors", "training.pointset", "training.profile", "training.segmap"),
    *(f"cli.{verb}" for verb in ORDER),
    *(f"cli.map_{verb}" for verb in MAPS),
}
"""Loaded by name: descriptors by pkgutil, networks by training.tasks, verbs by cli.verbs."""

MOST_LINES_OF_A_FILE = 300
MOST_LINES_OF_A_FUNCTION = 60
USUAL_LINES_OF_A_FUNCTION = 24  # nine of ten have no more


@functools.cache
def package() -> Package:
    """Read when it is first asked for, not when tests are collected."""
    return Package(PROJECT / "src" / "segloc", native=frozenset({"_native"}))


ROOMS = {room: height for height, layer in enumerate(LAYERS) for room in layer.rooms.split()}


def room_of(module: str) -> str:
    """The longest name of a room that a module's begins with; an error where there is none."""
    fitting = [room for room in ROOMS if f"{module}.".startswith(f"{room}.")]
    assert fitting, f"{module}: has no layer yet; give it one in LAYERS"
    return max(fitting, key=len)


def allowed(importer: str, target: str) -> bool:
    here, there = room_of(importer), room_of(target)
    if here == there:
        return True
    if here in ONLY and there not in ONLY[here].split():
        return False
    layer = LAYERS[ROOMS[here]]
    return ROOMS[here] < ROOMS[there] or (layer.together and there in layer.rooms.split())


def edges() -> Iterator[tuple[str, str]]:
    for importer, targets in sorted(package().imports.items()):
        yield from ((importer, target) for target in sorted(targets))


def test_imports_go_downwards() -> None:
    wrong = [
        f"{importer} -> {target}"
        for importer, target in edges()
        if not target.startswith("!") and not allowed(importer, target)
    ]
    assert not wrong, "\n".join(["imports that do not go downwards:", *wrong])


def test_no_modules_import_each_other_in_a_circle() -> None:
    circles = [", ".join(group) for group in package().circles()]
    assert not circles, "\n".join(["modules that need each other:", *circles])


def test_packages_of_others_stay_in_their_rooms() -> None:
    wrong = []
    for importer, target in edges():
        other = target[1:]
        if not target.startswith("!") or other in sys.stdlib_module_names:
            continue
        rooms = PACKAGES.get(other, "").split()
        if not any(room == "*" or f"{importer}.".startswith(f"{room}.") for room in rooms):
            wrong.append(f"{importer} -> {other}")
    assert not wrong, "\n".join(["imports of packages where PACKAGES has none:", *wrong])


def test_every_module_is_used() -> None:
    outside = source.files("lab/src", "examples")
    by_name = {
        name for name in package().files if any(f"{name}.".startswith(f"{b}.") for b in BY_NAME)
    }
    starts = {ROOT, "__main__"} | by_name | package().used_by(outside)
    unused = sorted(set(package().files) - package().reached(starts))
    assert not unused, f"modules that nothing imports: {', '.join(unused)}"


def too_long(found: list[Length], most: int) -> str:
    """A table of those above a limit."""
    return "\n".join(f"{item.lines:5} {item.where}" for item in found if item.lines > most)


def test_files_are_short() -> None:
    paths = source.files("src/segloc", "lab/src", "cpp", suffixes=(".py", ".cpp", ".h"))
    table = too_long(source.lengths(paths, source.file_length), MOST_LINES_OF_A_FILE)
    assert not table, f"files of more than {MOST_LINES_OF_A_FILE} lines:\n{table}"


def test_functions_are_short() -> None:
    paths = source.files("src/segloc", "lab/src")
    found = source.lengths(paths, source.python_functions)
    table = too_long(found, MOST_LINES_OF_A_FUNCTION)
    assert not table, f"functions of more than {MOST_LINES_OF_A_FUNCTION} lines:\n{table}"
    usual = np.percentile([item.lines for item in found], 90)
    longest = too_long(found[:40], 0)
    assert usual <= USUAL_LINES_OF_A_FUNCTION, f"one of ten has more than {usual}:\n{longest}"


def test_kernels_are_short() -> None:
    found = source.lengths(source.files("cpp", suffixes=(".cpp", ".h")), source.cpp_functions)
    assert len(found) > 300  # the layout is still the one that they are found by
    table = too_long(found, MOST_LINES_OF_A_FUNCTION)
    assert not table, f"functions of more than {MOST_LINES_OF_A_FUNCTION} lines:\n{table}"
