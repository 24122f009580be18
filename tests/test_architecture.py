"""Rooms import downwards only: read from the source, with imports in functions and for types."""

from __future__ import annotations

import functools
import sys
from collections.abc import Iterator

from samples.source import PROJECT, ROOT, Package

LAYERS = (
    "__main__",
    "cli",
    ROOT,
    "mapping robot",
    "batch live loops export",
    "inspect doctor sample",
    "datasets",
    "tracker",
    "tracking",
    "tiles",
    "joining",
    "localizer",
    "pipeline",
    "config",
    "proposals",
    "likelihood",
    "map",
    "descriptors",
    "frontend",
    "io",
    "scan_odometry",
    "localization prior motion",
    "geometry",
    "types",
    "system",
    "errors _native",
)
"""Top to bottom. A room imports rooms of lower layers, and none of its own layer."""

ONLY = {"io": {"motion", "geometry", "types", "system", "errors", "_native"}}
ONLY["datasets"] = ONLY["io"] | {"io", "scan_odometry"}
ONLY["sample"] = ONLY["io"] | {"datasets"}
"""Rooms that import no others than these: recordings know nothing of the method."""

CONVENIENCES = {
    "map.segment_map": {"mapping", "map.from_cloud", "map.config", "inspect.plots"},
    "localization": {"inspect.plots"},
}
"""What methods such as ``SegmentMap.from_scans`` import from above when they are called."""

PACKAGES = {
    "numpy": "*",
    "scipy": "*",
    "pydantic": "*",
    "yaml": "config map system",
    "laspy": "io",
    "lazrs": "io",
    "e57": "io",
    "trimesh": "io",
    "ifcopenshell": "io",
    "rosbags": "datasets.ros",
    "lz4": "datasets.ros",
    "velodyne_decoder": "datasets.packets",
    "kiss_icp": "scan_odometry",
    "matplotlib": "inspect batch localization map.segment_map",
    "viser": "inspect",
    "fsspec": "tiles",
    "pyproj": "map.georeference",
    "distributed": "system.processes",
    "typer": "cli",
    "rich": "cli",
}
"""Where packages of others are imported. The laboratory's are in none of these rooms."""


@functools.cache
def package() -> Package:
    found = Package(PROJECT / "src" / "segloc", native=frozenset({"_native"}))
    for module, targets in CONVENIENCES.items():
        assert targets <= found.imports[module], f"{module} no longer imports some of {targets}"
        found.imports[module] -= targets
    return found


HEIGHT = {room: height for height, layer in enumerate(LAYERS) for room in layer.split()}


def room_of(module: str) -> str:
    room = module.split(".")[0]
    assert room in HEIGHT, f"{module}: give its room a place in LAYERS"
    return room


def allowed(importer: str, target: str) -> bool:
    here, there = room_of(importer), room_of(target)
    if here == there:
        return True
    return HEIGHT[here] < HEIGHT[there] and there in ONLY.get(here, {there})


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
