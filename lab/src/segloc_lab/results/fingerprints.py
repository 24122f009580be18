"""Fingerprints of the stages of a query: of what their code says, not of how it is laid out."""

from __future__ import annotations

import ast
import hashlib
import io
import re
import tokenize
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml

PROJECT = Path(__file__).resolve().parents[4]
"""The clone that this package is installed from."""

STAGES: dict[str, tuple[str, ...]] = {
    "local cloud": (
        "src/segloc/frontend/local_cloud.py",
        "src/segloc/frontend/scan_window.py",
        "src/segloc/frontend/gravity.py",
        "cpp/frontend",
    ),
    "segmentation": ("src/segloc/frontend/segmentation.py", "cpp/frontend"),
    "descriptors": ("src/segloc/descriptors", "cpp/descriptors", "cpp/descriptors/network"),
    "map": ("src/segloc/map",),
    "matching": ("src/segloc/proposals/matching.py", "cpp/proposals/matching"),
    "pose": ("src/segloc/proposals/pose.py", "cpp/proposals/pose"),
    "geometric consistency": ("src/segloc/proposals/consistency.py", "cpp/proposals/pose"),
    "occupancy": ("src/segloc/occupancy", "cpp/proposals/occupancy"),
    "stems": ("src/segloc/landmarks",),
    "verification": (
        "src/segloc/verification",
        "src/segloc/likelihood/registration.py",
        "cpp/likelihood",
        "cpp/likelihood",
    ),
    "localizer": (
        "src/segloc/localizer.py",
        "src/segloc/pipeline/fallback.py",
        "src/segloc/config.py",
    ),
    "confidence": ("src/segloc/weights/confidence.json",),
    "training": ("src/segloc/training", "cpp/training"),
    "following": (
        "src/segloc/tracker.py",
        "src/segloc/tracking/hypotheses.py",
        "src/segloc/tracking/scan_check.py",
        "src/segloc/tracking/views.py",
        "src/segloc/frontend/rolling_cloud.py",
        "src/segloc/live",
    ),
    "tiles": ("src/segloc/tiles", "src/segloc/pipeline/coarse_vote.py"),
    "alignment": ("src/segloc/alignment", "src/segloc/pipeline/coarse_vote.py"),
    "simulation": ("src/segloc/simulation",),
    "reading": ("src/segloc/io", "src/segloc/system/budget.py", "cpp/io"),
}
"""Folders and files of each stage of a query, of SegMatch's estimator, and of what trains, follows,
tiles, aligns, simulates and reads files."""

_OTHERS = (
    "geometric consistency",
    "training",
    "following",
    "tiles",
    "alignment",
    "simulation",
    "reading",
)

LOCALIZING = tuple(name for name in STAGES if name not in _OTHERS)
"""The stages of a single query, by the default estimator or PROSAC."""

COMPARING = (*LOCALIZING, "geometric consistency")
"""And of one by any estimator, as methods are compared."""

FOLLOWING = (*LOCALIZING, "following")
"""And of a robot that is followed."""

DESCRIBING = ("local cloud", "segmentation", "descriptors")
"""The stages that figures of descriptors alone depend on."""

_WEIGHTS = ("src/segloc/weights", "lab/src/segloc_lab/weights")

_PREFIX = 12


def fingerprints(
    stages: Iterable[str] = LOCALIZING, methods: Iterable[str] = (), root: Path = PROJECT
) -> dict[str, str]:
    """A short hash of each stage, and of what is shipped for each method.

    No change of comments, docstrings or layout changes it. The weights of a method are named
    "weights of METHOD".
    """
    found = {stage: _of(root, [root / path for path in STAGES[stage]]) for stage in stages}
    for method in methods:
        name = method.removesuffix("-fq")
        names = [f"{stem}.safetensors" for stem in (name, f"{name}-forest")]
        own = [root / folder / each for folder in _WEIGHTS for each in names]
        own = [file for file in own if file.is_file()]
        if own:
            found[f"weights of {method}"] = _of(root, own)
    return found


def changed(before: Mapping[str, str], root: Path = PROJECT) -> list[str]:
    """Of what a result names, what is no longer as it was."""
    stages = [name for name in before if name in STAGES]
    methods = [name.removeprefix("weights of ") for name in before if name not in STAGES]
    now = fingerprints(stages, methods, root)
    return [name for name, value in before.items() if now.get(name) != value]


@dataclass(frozen=True)
class Change:
    """A change of the code that leaves most results as they are.

    Attributes
    ----------
    stages : dict of str to (str, str)
        Fingerprints before and after.
    concerns : str
        What the results may depend on that it changes.
    may_change : tuple of str
        Names of these results.
    checked : str
        How it was checked that it leaves others as they are.
    """

    stages: Mapping[str, tuple[str, str]]
    concerns: str
    may_change: tuple[str, ...]
    checked: str

    def applied(self, before: Mapping[str, str]) -> dict[str, str]:
        """Of fingerprints, what has become of those that it changes."""
        stages = self.stages.items()
        return {name: after for name, (old, after) in stages if before.get(name) == old}


def brought_forward(
    before: Mapping[str, str], changes: Iterable[Change]
) -> tuple[dict[str, str], list[Change]]:
    """Fingerprints after changes, one after another; and those of the changes that apply."""
    after, applied = dict(before), []
    for change in changes:
        if now := change.applied(after):
            after |= now
            applied.append(change)
    return after, applied


def changes_without_effect_on(name: str, root: Path = PROJECT) -> list[Change]:
    """The changes of ``docs/unaffected.yaml`` that leave a result as it is, in their order."""
    path = root / "docs" / "unaffected.yaml"
    entries = yaml.safe_load(path.read_text("utf-8")) if path.exists() else ()
    found = [
        Change(
            {stage: (old, new) for stage, (old, new) in entry["stages"].items()},
            entry["concerns"],
            tuple(entry["may_change"]),
            entry["checked"],
        )
        for entry in entries
    ]
    return [change for change in found if name not in change.may_change]


def _of(root: Path, paths: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        for file in _files(path):
            digest.update(file.relative_to(root).as_posix().encode() + b"\0")
            facts = file.stat()
            digest.update(_read_once(file, facts.st_mtime_ns, facts.st_size) + b"\0")
    return digest.hexdigest()[:_PREFIX]


def _files(path: Path) -> Iterator[Path]:
    if path.is_file():
        yield path
    for file in sorted(path.rglob("*")) if path.is_dir() else ():
        if file.is_file() and "__pycache__" not in file.parts:
            yield file


@cache
def _read_once(file: Path, changed_ns: int, size: int) -> bytes:
    """Of a file as it is now: many results depend on the same ones."""
    del changed_ns, size
    return meaning(file)


def meaning(file: Path) -> bytes:
    """A file without what does not count: Python and C++ without comments and white space."""
    content = file.read_bytes()
    if file.suffix == ".py":
        content = _python(content.decode("utf-8")).encode()
    elif file.suffix in (".cpp", ".h"):
        text = re.sub(r"//[^\n]*|/\*.*?\*/", "", content.decode("utf-8"), flags=re.DOTALL)
        content = "".join(text.split()).encode()
    return content


def _python(text: str) -> str:
    """Python source without docstrings, comments and white space."""
    lines = text.splitlines(keepends=True)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            line, column = token.start
            lines[line - 1] = lines[line - 1][:column] + "\n"
    for first, last in _docstrings(text):
        lines[first - 1 : last] = [""] * (last - first + 1)
    return "".join("".join(lines).split())


def _docstrings(text: str) -> Iterator[tuple[int, int]]:
    """First and last line of every string that stands by itself."""
    for node in ast.walk(ast.parse(text)):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
            and node.end_lineno is not None
        ):
            yield node.lineno, node.end_lineno
