"""Fill the tables of docs/architecture.md that are read off the source.

python docs/generate.py            # writes the tables between their markers
python docs/generate.py --check    # exit status 1 where a table is stale
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"
PACKAGE = ROOT / "src" / "segloc"
TOLERANCE = 0.10
"""Lines may differ by this share, and a few, before a table counts as stale."""

# Top to bottom, as tests/test_architecture.py holds them: a room may import what stands below it.
ROOMS: dict[str, tuple[int, str]] = {
    "__main__.py": (1, "`python -m segloc`"),
    "cli": (1, "the command line, one module a verb"),
    "batch": (2, "many queries at once: run, score, negative maps, reports"),
    "alignment": (2, "sessions with drifting poses brought into one frame"),
    "export": (2, "maps and results in the formats of others"),
    "live": (2, "a robot followed in threads of its own"),
    "training": (2, "networks and forests trained and exported; the only room with PyTorch"),
    "explanation": (2, "one query through every stage, in words and pictures"),
    "simulation": (3, "worlds, objects, sensors, motion"),
    "sample": (3, "a recorded drive to map, another day, another town"),
    "diagnosis": (3, "what is wrong with a recording, measured, and how to mend it"),
    "pictures.py": (3, "the one look of all pictures: colours, ground plans, scales"),
    "datasets": (4, "recordings: loaders, bags, packets, odometry"),
    "tracker.py": (4, "many queries over time"),
    "scan_check.py": (4, "what a single scan says of a pose"),
    "hypotheses.py": (4, "a believed track, and candidates for another"),
    "views.py": (4, "what one query says of where a robot is"),
    "tiles": (4, "maps in tiles: cut, fetched, searched, changed"),
    "localizer.py": (5, "the method on one page"),
    "fallback.py": (5, "other candidates where segments say little"),
    "search.py": (5, "what passes between the stages of a query"),
    "thin_vote.py": (5, "where in a thin map of many places a query may be"),
    "answer.py": (5, "a verdict to the answer"),
    "landmarks": (7, "stems found in clouds, and landmarks of one's own: a pose, or candidates"),
    "config.py": (6, "all settings, one preset a method"),
    "attitude.py": (8, "which way is up in a scan"),
    "mounting.py": (8, "how a sensor is mounted on its base"),
    "local_cloud.py": (7, "scans to local cloud"),
    "scan_window.py": (7, "the scans of a window on one lattice, to local clouds"),
    "rolling_cloud.py": (7, "scans one by one to the local cloud of a robot that drives on"),
    "levelling.py": (7, "whether the frame of a recording is level, and turning it"),
    "segmentation.py": (7, "local cloud to segments"),
    "matching.py": (7, "descriptors to matches"),
    "pose.py": (7, "matches to candidate poses"),
    "consistency.py": (7, "matches that keep their distances, to candidate poses"),
    "occupancy": (7, "occupancy to candidate poses, when segments say too little"),
    "registration.py": (7, "generalised ICP"),
    "verification": (7, "candidate poses to one verified pose, or a reason"),
    "map": (7, "the prior map: table, cloud, file, merge; build and update"),
    "descriptors": (8, "segments to vectors, one file a descriptor"),
    "io": (9, "point-cloud and trajectory files"),
    "localization.py": (10, "the answer to a query, and why there is none"),
    "motion.py": (10, "where a sensor is at any moment; de-skewing"),
    "reposed.py": (10, "a recording with other poses"),
    "processes.py": (10, "work in several processes"),
    "files.py": (10, "files replaced whole or not at all"),
    "tensor_file.py": (10, "files in safetensors layout, read and not mapped"),
    "system.py": (10, "which processor this is"),
    "stage_times.py": (10, "milliseconds of each stage"),
    "yamlfile.py": (10, "YAML within limits"),
    "locks.py": (11, "one writer at a time"),
    "checks.py": (11, "input refused at the door"),
    "section.py": (11, "what every section of the configuration refuses"),
    "budget.py": (11, "what one input may hold at most"),
    "geometry.py": (11, "rigid transforms"),
    "georeference.py": (11, "where on the globe a map lies"),
    "prior.py": (11, "where the sensor is known to be"),
    "types.py": (11, "the data that flows: scans, segments, matches, answers"),
    "errors.py": (11, "the one family of exceptions"),
}
"""Layer and purpose of each room of the package."""

KERNELS = {
    "bindings": "Python functions: shapes checked, interpreter's lock released",
    "verification": "visibility of map points, point index for overlap, correlation",
    "registration": "generalised ICP, normals on demand",
    "occupancy": "maps seen from above, branch and bound over poses",
    "pose": "votes, Hough accumulator, refinement, PROSAC",
    "consistency": "geometric consistency: SegMatch's estimator",
    "matching": "nearest descriptors, inverted file, random forests",
    "network": "X-conv networks, SegMap's network, perceptron",
    "descriptors": "alignment, farthest-point sampling, profile, Gestalt, shape functions",
    "local_cloud": "the scans of a window on one lattice",
    "segmentation": "voxel grid, ground, Euclidean clusters",
    "training": "forward and backward passes that PyTorch is slow at",
    "io": "LZF of PCD files",
    "simd": "instruction sets chosen at run time",
    "common": "threads, cells, rigid fits, checks of finite values",
    "tests": "tests without Python, for sanitizers",
}
"""What lies in each room of cpp/."""

Row = tuple[str, ...]


def rooms() -> list[Row]:
    """Room, layer, files, lines, what it imports, what it is for."""
    rows = []
    present = {name for name in ROOMS if (PACKAGE / name).exists()}
    for name, (layer, purpose) in ROOMS.items():
        if name not in present:
            continue
        files = _sources(PACKAGE / name)
        imported = {room for file in files for room in _imported(file)} - {name}
        named = [f"`{room}`" for room in ROOMS if room in imported]
        lines = sum(len(file.read_text("utf-8").splitlines()) for file in files)
        rows.append(
            (f"`{name}`", str(layer), str(len(files)), str(lines), " ".join(named) or "-", purpose)
        )
    return rows


def unplaced() -> list[str]:
    """Modules and packages that have no layer yet."""
    found = [p for p in PACKAGE.iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()]
    return sorted({p.name for p in found} - ROOMS.keys() - {"__init__.py", "weights"})


def kernels() -> list[Row]:
    """Room of cpp/, files, lines, what it is for."""
    rows = []
    for name, purpose in KERNELS.items():
        files = [*(ROOT / "cpp" / name).rglob("*.cpp"), *(ROOT / "cpp" / name).rglob("*.h")]
        lines = sum(len(file.read_text("utf-8").splitlines()) for file in files)
        rows.append((f"`cpp/{name}`", str(len(files)), str(lines), purpose))
    return rows


TABLES = {
    "rooms": (("room", "layer", "files", "lines", "imports", "what it is for"), rooms),
    "kernels": (("room", "files", "lines", "what it is for"), kernels),
}


def written(page: str) -> str:
    """The page with every table filled in anew."""
    for name, (columns, rows) in TABLES.items():
        lines = [columns, tuple("---" for _ in columns), *rows()]
        table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        pattern = rf"(<!-- begin {name} -->\n).*?(<!-- end {name} -->)"
        page, count = re.subn(pattern, rf"\g<1>{table}\n\g<2>", page, flags=re.DOTALL)
        if count != 1:
            raise SystemExit(f"{PAGE.name}: {count} places for the table {name!r}")
    return page


def stale(page: str) -> list[str]:
    """What of the page no longer holds: lines and files to within the tolerance."""
    faults = [f"{name}: has no layer in docs/generate.py" for name in unplaced()]
    for have, want in zip(_rows(page), _rows(written(page)), strict=False):
        if len(have) != len(want) or not all(map(_close, have, want)):
            faults.append(f"{' | '.join(have)}   is now   {' | '.join(want)}")
    if len(list(_rows(page))) != len(list(_rows(written(page)))):
        faults.append("rooms were added or removed")
    return faults


def _rows(page: str) -> Iterator[list[str]]:
    for name in TABLES:
        found = re.search(rf"<!-- begin {name} -->\n(.*?)<!-- end {name} -->", page, re.DOTALL)
        for line in (found[1] if found else "").splitlines():
            yield [cell.strip() for cell in line.strip("|").split("|")]


def _close(have: str, want: str) -> bool:
    if have.isdecimal() and want.isdecimal():
        return abs(int(have) - int(want)) <= max(3, TOLERANCE * int(want))
    return have == want


def _sources(path: Path) -> list[Path]:
    return sorted(path.rglob("*.py")) if path.is_dir() else [path]


def _imported(file: Path) -> Iterator[str]:
    """The rooms that a module imports, in functions and for types alone, too."""
    inside = ("segloc", *file.relative_to(PACKAGE).parts[:-1])
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if not isinstance(node, ast.ImportFrom) or not node.level:
            continue
        module = (*inside[: len(inside) - node.level + 1], *(node.module or "").split("."))
        parts = [part for part in module if part]
        for name in [parts[1]] if len(parts) > 1 else [alias.name for alias in node.names]:
            yield name if name in ROOMS else f"{name}.py"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true")
    page = PAGE.read_text("utf-8")
    if parser.parse_args().check:
        faults = stale(page)
        print("\n".join(faults) or "current")
        sys.exit(bool(faults))
    PAGE.write_text(written(page), encoding="utf-8")


if __name__ == "__main__":
    main()
