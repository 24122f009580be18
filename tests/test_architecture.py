"""Rooms import downwards only: read from the source, with imports in functions and for types.

What a robot loads imports nothing of ``tools``, which is around it, but for named conveniences.
"""

from __future__ import annotations

import ast
import functools
import sys
from collections.abc import Iterator

from samples.source import PROJECT, ROOT, Package

LAYERS = (
    "__main__",
    "tools.cli",
    "tools.batch tools.export",
    "tools.inspect tools.doctor",
    "tools.datasets",
    "tools.io",
    "tools",
    ROOT,
    "mapping robot sample",
    "live loops",
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
    "scan_odometry",
    "localization prior motion",
    "geometry",
    "types",
    "system",
    "errors _native",
)
"""Top to bottom. A room imports rooms of lower layers, and none of its own layer."""

ONLY = {"tools.io": {"motion", "geometry", "types", "system", "errors", "_native"}}
ONLY["tools.datasets"] = ONLY["tools.io"] | {"tools.io", "scan_odometry"}
ONLY["sample"] = ONLY["tools.io"]
"""Rooms that import no others than these: recordings know nothing of the method."""

CONVENIENCES = {
    ROOT: {"tools.datasets"},
    "robot": {
        "tools.batch.run",
        "tools.datasets.clocks",
        "tools.datasets.fixes",
        "tools.datasets.gravity",
        "tools.datasets.ros.bag_messages",
        "tools.datasets.ros.bag_tf",
        "tools.datasets.ros.pointcloud2",
        "tools.doctor.finding",
        "tools.doctor.scan_faults",
        "tools.io.clouds",
        "tools.io.point_times",
    },
    "mapping": {"tools.doctor"},
    "sample": {"tools.datasets.recorded"},
    "map.segment_map": {"mapping", "map.from_cloud", "map.config", "tools.inspect.plots"},
    "localization": {"tools.inspect.plots"},
}
"""What promised names such as ``SegmentMap.from_scans`` import from above on first use."""

PACKAGES = {
    "numpy": "*",
    "scipy": "*",
    "pydantic": "*",
    "yaml": "config map system",
    "laspy": "tools.io",
    "lazrs": "tools.io",
    "e57": "tools.io",
    "trimesh": "tools.io",
    "ifcopenshell": "tools.io",
    "rosbags": "tools.datasets.ros",
    "lz4": "tools.datasets.ros",
    "velodyne_decoder": "tools.datasets.packets",
    "kiss_icp": "scan_odometry",
    "matplotlib": "tools.inspect tools.batch localization map.segment_map",
    "viser": "tools.inspect",
    "fsspec": "tiles",
    "pyproj": "map.georeference",
    "distributed": "system.processes",
    "typer": "tools.cli",
    "rich": "tools.cli",
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
    parts = module.split(".")
    room = ".".join(parts[: 2 if parts[0] == "tools" else 1])
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


def test_the_core_imports_tools_on_use_only() -> None:
    wrong = [
        f"{name}: line {node.lineno}"
        for name, path in sorted(package().files.items())
        if not name.startswith(("tools", "__main__"))
        for node in ast.parse(path.read_text("utf-8")).body
        if isinstance(node, ast.ImportFrom) and "tools" in (node.module or "").split(".")
    ]
    assert not wrong, "\n".join(["tools that are loaded with the core:", *wrong])


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
