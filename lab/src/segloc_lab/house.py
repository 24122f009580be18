"""Count lines by part of the repository, and what a robot loads of the package.

python -m segloc_lab.house
python -m segloc_lab.house --against OTHER_TREE --report reports/VERSION-house
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from .report import Cell, Table, publish, reporting

TOOLS = ("tools", "batch", "cli", "datasets", "doctor", "export", "inspect", "io")
"""Folders around a map: one, and where its rooms were until 0.3.0."""
PARTS = {
    "package, what a robot loads": ("src/segloc", (".py", ".pyi")),
    "package, tools": ("src/segloc", (".py",)),
    "kernels and bindings": ("cpp", (".h", ".cpp")),
    "their tests and fuzzers": ("cpp", (".h", ".cpp")),
    "plug-ins": ("plugins", (".py",)),
    "ROS 2": ("ros2", (".py",)),
    "laboratory": ("lab/src", (".py",)),
    "tests": ("tests", (".py",)),
    "tests of the laboratory": ("lab/tests", (".py",)),
}
_PACKAGE = Path("src/segloc")
_CPP_TESTS = ("tests", "fuzz")
_RUNS = 3
_NAMES = ("Localizer", "SegmentMap", "Scan"), ("LiveLocalizer", "SegmentMap", "Scan")
"""What a robot takes from the package to answer a query, and to follow its pose."""
_LOADED = """
import json, sys, time
began = time.process_time()
import segloc
took = [1000 * (time.process_time() - began)]
for name in sys.argv[1:]:
    getattr(segloc, name)
took.append(1000 * (time.process_time() - began))
files = [getattr(module, "__file__", None) for name, module in sys.modules.items()
         if name.split(".")[0] == "segloc"]
print(json.dumps([files, took]))
"""


def _lines(path: Path) -> int:
    return path.read_bytes().count(b"\n")


def _is_tool(root: Path, path: Path) -> bool:
    return path.relative_to(root / _PACKAGE).parts[0] in TOOLS


def _files(root: Path, name: str) -> Iterator[Path]:
    """Yield the files of one of the ``PARTS`` below a tree."""
    folder, suffixes = PARTS[name]
    for path in sorted((root / folder).rglob("*")):
        if path.suffix not in suffixes or "build" in path.relative_to(root).parts:
            continue
        if folder == str(_PACKAGE) and _is_tool(root, path) != name.endswith("tools"):
            continue
        is_test = path.relative_to(root / folder).parts[0] in _CPP_TESTS
        if folder != "cpp" or is_test == name.endswith("fuzzers"):
            yield path


def counts(root: Path) -> dict[str, int]:
    """Count the lines of each part of a tree."""
    return {name: sum(map(_lines, _files(root, name))) for name in PARTS}


def loaded(root: Path, *names: str) -> tuple[set[Path], list[float]]:
    """Return the package's files that are loaded with some of its names, and times of import [ms].

    The processor times are the least of a few runs: of ``import segloc``, and with the names.
    """
    # Without site: an editable install would come before the tree.
    path = os.pathsep.join([str(root / "src"), *filter(None, sys.path)])
    runs = []
    for _ in range(_RUNS):
        done = subprocess.run(
            [sys.executable, "-S", "-c", _LOADED, *names],
            env={**os.environ, "PYTHONPATH": path},
            check=True,
            capture_output=True,
            text=True,
        )
        runs.append(json.loads(done.stdout))
    files = {Path(file) for file in runs[0][0] if file and file.endswith(".py")}
    return files, [min(times) for times in zip(*(took for _, took in runs), strict=True)]


def facts(root: Path) -> dict[str, Cell]:
    """Return all figures of a tree by their names."""
    root = root.resolve()
    found: dict[str, Cell] = dict(counts(root))
    needed = sum(
        _lines(p) for p in _files(root, "package, what a robot loads") if p.suffix == ".py"
    )
    for names in _NAMES:
        files, (bare, first) = loaded(root, *names)
        tools = sum(_lines(path) for path in files if _is_tool(root, path))
        used = sum(map(_lines, files)) - tools
        share = f"{used} ({100 * used / needed:.0f} %)"
        found[f"loaded by {names[0]}: of the core"] = share
        found[f"loaded by {names[0]}: of tools"] = tools
        found[f"import of {names[0]}"] = f"{first:.0f} ms"
    found["import segloc"] = f"{bare:.0f} ms"
    return found


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("--against", type=Path, metavar="TREE", help="count beside another tree")
    args = options.parse_args()
    trees = [args.against, Path()] if args.against is not None else [Path()]
    each = [facts(tree) for tree in trees]
    columns = ("part", "before", "now")[: len(trees) + 1] if len(trees) > 1 else ("part", "now")
    rows = [(name, *(found[name] for found in each)) for name in each[-1]]
    note = "Lines with comments and blank ones. Tools are the rooms of `segloc/tools`."
    publish(args.report, "Lines by part, and what a robot loads", Table(columns, rows, note))


if __name__ == "__main__":
    main()
