"""Gather the pages of the documentation site: written ones, and those generated from the code.

python docs/site.py    # into build/site/pages; `make docs` then builds them

Links to files that are not pages, such as source files, become plain text.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import typer
from pydantic import BaseModel

import segloc
from segloc.config import Config
from segloc.descriptors import weightfile
from segloc.likelihood.model import Model
from segloc.live import core, replay
from segloc.live.core import StateReason
from segloc.localization import Explained, Reason
from segloc.map import file as mapfile
from segloc.tiles.index import Tile, TileIndex
from segloc.tools.batch import score
from segloc.tools.cli import app
from segloc.tools.export.formats import FORMATS
from segloc.tools.inspect import alignment

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "build" / "site" / "pages"
SOURCE = ROOT / "build" / "site" / "source"
"""Copy of the package with the roles of its docstrings resolved, for the page of the API."""
MOVED = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
}
ROLE = re.compile(r":(?:class|func|meth|attr|data|mod|exc):`(~?)\.?([\w.]+)`")
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")


def written() -> dict[Path, Path]:
    """Return the goal of every written page and picture."""
    found = {ROOT / name: PAGES / page for name, page in MOVED.items()}
    for path in sorted((ROOT / "docs").rglob("*")):
        if path.suffix in (".md", ".png", ".svg", ".webp"):
            found[path] = PAGES / path.relative_to(ROOT / "docs")
    for path in sorted((ROOT / "reports").rglob("*.md")):
        found[path] = PAGES / path.relative_to(ROOT)
    return found


def relinked(text: str, page: Path, places: dict[Path, Path]) -> str:
    """Return a page with links to the pages of the site."""

    def link(match: re.Match[str]) -> str:
        mark, label, target = match.groups()
        if "://" in target or target.startswith(("#", "mailto:")):
            return match[0]
        path, hash_, anchor = target.partition("#")
        goal = (page.parent / path).resolve()
        goal = goal / "README.md" if goal.is_dir() else goal
        if goal not in places:
            return label
        relative = os.path.relpath(places[goal], places[page].parent)
        if label.endswith(".md"):  # a file name: the title of its page instead
            label = _heading(goal)
        return f"{mark}[{label}]({relative}{hash_}{anchor})"

    return LINK.sub(link, text)


def _heading(page: Path) -> str:
    found = re.search(r"^# (.+)$", page.read_text("utf-8"), re.MULTILINE)
    return found[1].strip() if found else page.stem


def commands(command: Any, name: str) -> Iterator[str]:
    """Yield a section per verb: its help, arguments and options."""
    if name != "segloc":
        yield f"\n## {name}\n\n{command.help or ''}\n"
    if hasattr(command, "commands"):
        for verb in command.list_commands(None):
            yield from commands(command.commands[verb], f"{name} {verb}")
        return
    yield "\n| argument or option | default | meaning |\n|---|---|---|\n"
    for option in command.params:
        if option.name != "help":
            yield f"| {_names(option)} | {_default(option)} | {_cell(option.help or '')} |\n"


def _names(option: Any) -> str:
    value = "" if getattr(option, "is_flag", False) else f" {option.metavar or ''}"
    value += "..." if option.nargs == -1 else ""
    names = option.opts if option.param_type_name == "option" else []
    return f"`{_cell((', '.join(names) + value).strip())}`"


def _default(option: Any) -> str:
    if option.required:
        return "required"
    if isinstance(option.show_default, str):
        return _cell(option.show_default)
    default = option.default
    empty = default is None or default is False or default == "" or callable(default)
    return "" if empty else f"`{_cell(str(default))}`"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def configuration() -> str:
    """Return the page of configuration keys, with defaults and meanings."""
    text = Config.load(None, None).explained(True)
    head = "# Configuration\n\nEvery key with its default, as `segloc config --all` prints it.\n"
    return f"{head}\n```yaml\n{text.rstrip()}\n```\n"


def api() -> str:
    """Return the page of public names."""
    names = sorted(name for name in segloc.__all__ if not name.startswith("_"))
    sections = [f"\n::: segloc.{name}\n" for name in names]
    head = (
        "# Python\n\nThe public names of `import segloc`. Those of `segloc.geometry`, "
        "`segloc.live`, `segloc.robot` and `segloc.tiles` are promised, too; "
        "`help(segloc.robot)` lists them.\n"
    )
    return head + "".join(sections)


def filled(page: str) -> str:
    """Return a page with the tables that its lines ``<!-- table of NAME -->`` name."""
    return MARK.sub(lambda match: table(match[1]), page)


def table(name: str) -> str:
    """Return a generated table in Markdown."""
    head, rows = TABLES[name]
    lines = [head, ("---",) * len(head), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _reasons(members: Iterable[Explained]) -> list[tuple[str, ...]]:
    return [(re.sub(r"\{.*?\}", "...", m.value), m.likely_cause, m.remedy) for m in members]


def _keys(meanings: Mapping[str, str]) -> list[tuple[str, ...]]:
    return [(f"`{name}`", meaning) for name, meaning in meanings.items()]


def _fields(model: type[BaseModel]) -> list[tuple[str, ...]]:
    fields = model.model_fields.items()
    return _keys({name: info.description or "" for name, info in fields})


def _tensors() -> list[tuple[str, ...]]:
    rows = []
    for name, (dtype, shape, meaning) in mapfile.SCHEMA.items():
        lengths = ", ".join(map(str, shape)) + "," * (len(shape) == 1)
        rows.append((f"`{name}`", dtype, f"({lengths})", meaning))
    return rows


_REASON, _KEY = ("reason", "likely cause", "remedy"), ("key", "meaning")
TABLES: dict[str, tuple[tuple[str, ...], list[tuple[str, ...]]]] = {
    "reasons": (_REASON, _reasons(Reason)),
    "states": (_REASON, _reasons(StateReason)),
    "map tensors": (("tensor", "dtype", "shape", "meaning"), _tensors()),
    "map fields": (_KEY, _keys(mapfile.FIELDS)),
    "tiles": (_KEY, _fields(TileIndex)),
    "tile": (_KEY, _fields(Tile)),
    "weights fields": (_KEY, _keys(weightfile.FIELDS)),
    "posterior": (_KEY, _fields(Model)),
    "localizations": (_KEY, _keys(score.RECORD)),
    "localize summary": (_KEY, _keys(score.SUMMARY)),
    "live states": (_KEY, _keys(core.RECORD)),
    "live summary": (_KEY, _keys(replay.SUMMARY)),
    "loops": (_KEY, _keys(alignment.RECORD)),
    "export formats": (
        ("format", "source", "output"),
        [(f"`{name}`", kind.requirement, kind.text) for name, kind in FORMATS.items()],
    ),
}
"""Head and rows of the tables that are generated from the code, by name."""
MARK = re.compile(r"<!-- table of ([a-z ]+) -->\n")


def resolved(text: str) -> str:
    """Return a docstring with Sphinx roles turned into links to the API, or into code."""
    public = {name for name in segloc.__all__ if not name.startswith("_")}

    def plain(match: re.Match[str]) -> str:
        short, name = match.groups()
        inner = name.removeprefix("segloc.")
        shown = name.rpartition(".")[2] if short else inner
        # Of members, only those with their class.
        known = inner.split(".")[0] in public and inner.count(".") < 2
        return f"[`{shown}`][segloc.{inner}]" if known else f"`{shown}`"

    return ROLE.sub(plain, text)


def write_source() -> None:
    """Write a copy of the package to read docstrings from."""
    shutil.rmtree(SOURCE, ignore_errors=True)
    package = ROOT / "src" / "segloc"
    for path in [*package.rglob("*.py"), *package.rglob("*.pyi")]:
        goal = SOURCE / "segloc" / path.relative_to(package)
        goal.parent.mkdir(parents=True, exist_ok=True)
        goal.write_text(resolved(path.read_text("utf-8")), "utf-8")


def main() -> None:
    write_source()
    shutil.rmtree(PAGES, ignore_errors=True)
    places = written()
    for source, goal in places.items():
        goal.parent.mkdir(parents=True, exist_ok=True)
        if source.suffix == ".md":
            text = filled(source.read_text("utf-8"))
            goal.write_text(relinked(text, source, places), "utf-8")
        else:
            shutil.copy(source, goal)
    root: Any = typer.main.get_command(app)
    verbs = "# Commands\n\nEvery verb with its options, as `--help` prints them.\n"
    generated = {
        "commands": verbs + "".join(commands(root, "segloc")),
        "configuration": configuration(),
        "api": api(),
    }
    for name, text in generated.items():
        (PAGES / "reference" / f"{name}.md").write_text(text, "utf-8")


if __name__ == "__main__":
    main()
