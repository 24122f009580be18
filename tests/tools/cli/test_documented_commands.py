"""Every command, option, extra and target that documents, messages and help texts name exists.

None is run: ``tests/docs/test_documents_run.py`` runs those of the documents.
"""

from __future__ import annotations

import ast
import functools
import json
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer
from samples.documents import code, documents
from samples.source import PROJECT

from segloc.errors import MissingDependency
from segloc.tools.cli import app

BY_OTHERS = {"bench": {"bench", "evaluate", "simulate", "train"}, "stems": {"stems"}}
"""Verbs that segloc-lab and a plug-in add, or add to, by one that is there if they are."""

BESIDE = [page for name in ("lab", "plugins") for page in sorted((PROJECT / name).rglob("*.md"))]
PAGES = [*documents(), PROJECT / "CONTRIBUTING.md", PROJECT / "SECURITY.md", *BESIDE]
PROGRAM = [path for name in ("src", "ros2", "plugins") for path in (PROJECT / name).rglob("*.py")]
SOURCES = sorted([*PROGRAM, *(PROJECT / "lab" / "src").rglob("*.py")])

_FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
_SPAN = re.compile(r"`segloc ([^`]+)`")
_OPTION = re.compile(r"(?<![\w-])--[a-z][\w-]*")
_OTHER_PROGRAM = re.compile(r"`(?:python|ros2)[^`]*`")
_MAKE = re.compile(r"(?:^ {4}|`)make ([a-z][^`#\n]*)", re.MULTILINE)
_PIP = re.compile(r"pip install ([^`#\n]*)")
_PIP_TARGET = re.compile(r"([^\[]+)(?:\[([^]]*)\])?")
_EXTRAS = re.compile(r"\bextras? (`[\w-]+`(?:(?:, | and )`[\w-]+`)*)")
_ALTERNATIVES = re.compile(r"[\w-]+(\|[\w-]+)+")


class Command(NamedTuple):
    """A command as documented. A whole one has all its arguments, others only names."""

    place: str
    words: tuple[str, ...]
    whole: bool


def commands(path: Path) -> Iterator[Command]:
    """Those of code blocks, and spans of code in the text."""
    for each in code(path):
        if each.text.startswith("segloc "):
            yield Command(each.place, tuple(_words(each.text)[1:]), whole=True)
    text = _FENCED.sub(lambda block: "\n" * block[0].count("\n"), path.read_text("utf-8"))
    for number, line in enumerate(text.splitlines(), 1):
        for found in _SPAN.finditer("" if line.startswith("    ") else line):
            place = f"{path.relative_to(PROJECT)}:{number}"
            yield Command(place, tuple(_words(found[1])), whole=False)


@functools.cache
def messages(path: Path) -> list[tuple[str, str]]:
    """The place and the text of each string of a module, docstrings too; values as X."""
    found: list[tuple[str, str]] = []
    pending: list[ast.AST] = [ast.parse(path.read_text("utf-8"))]
    while pending:
        node = pending.pop()
        if isinstance(node, ast.JoinedStr):
            parts = [part.value if isinstance(part, ast.Constant) else "X" for part in node.values]
            found.append((f"{path.relative_to(PROJECT)}:{node.lineno}", "".join(map(str, parts))))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.append((f"{path.relative_to(PROJECT)}:{node.lineno}", node.value))
        else:
            pending += ast.iter_child_nodes(node)
    return found


def texts() -> Iterator[tuple[str, str]]:
    """Those of all modules, all pages line by line, and cells of notebooks."""
    for path in SOURCES:
        yield from messages(path)
    for path in PAGES:
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
            yield f"{path.relative_to(PROJECT)}:{number}", line
    for path in (PROJECT / "examples").glob("*.ipynb"):
        for cell in json.loads(path.read_text("utf-8"))["cells"]:
            yield str(path.relative_to(PROJECT)), "".join(cell["source"])


def _words(text: str) -> list[str]:
    """Without comments, and without the brackets around what may be left out."""
    return shlex.split(re.sub(r"\[(-[^]]*)\]", r"\1", text), comments=True)


def faults(command: Any, words: list[str], whole: bool) -> list[str]:
    """Why the words are no command, or nothing."""
    names = dict(getattr(command, "commands", {}))
    if names and words and not words[0].startswith("-"):
        if _ALTERNATIVES.fullmatch(words[0]):
            each = [faults(command, [name, *words[1:]], whole) for name in words[0].split("|")]
            return [fault for found in each for fault in found]
        if words[0].startswith("$") or words[0].isupper():  # any of them
            each = [faults(inner, words[1:], whole) for inner in names.values()]
            return min(each, key=len)
        if words[0] not in names:
            return [f"no {words[0]!r} among {', '.join(names)}"]
        return faults(names[words[0]], words[1:], whole)
    if whole:
        try:
            command.make_context(command.name, words)
        except Exception as error:
            output = getattr(error, "format_message", error.__str__)
            return [output()]
        return []
    known = {option for parameter in command.params for option in _options(parameter)}
    given = (word.partition("=")[0].rstrip(".,") for word in words if word.startswith("-"))
    return [f"no option {option}" for option in given if option not in known | {"-h", "--help"}]


def _options(parameter: Any) -> list[str]:
    return [*parameter.opts, *parameter.secondary_opts]


def all_options(command: Any) -> set[str]:
    """Options of all verbs of a command."""
    inner = getattr(command, "commands", {}).values()
    own = {option for parameter in command.params for option in _options(parameter)}
    return own.union(*(all_options(each) for each in inner), {"--help"})


def extras(folder: Path) -> set[str]:
    """Extras of a distribution."""
    text = (folder / "pyproject.toml").read_text("utf-8")
    section = text.partition("[project.optional-dependencies]\n")[2].partition("\n[")[0]
    return set(re.findall(r"^([\w-]+) = \[", section, re.MULTILINE))


def install_faults(arguments: str) -> Iterator[str]:
    """Why what ``pip install`` is given cannot be installed; other projects are not looked at."""
    words = iter(shlex.split(arguments.rstrip(").:;,")))
    for word in words:
        if word in ("-c", "-r"):
            next(words, None)
            continue
        found = _PIP_TARGET.match(word)
        if word.startswith("-") or found is None:
            continue
        name = found[1]
        if name in ("segloc", "segloc-lab"):
            yield f"{name} is not published: name its folder"
        elif name in (".", "SEGLOC") or name.startswith("./"):
            folder = PROJECT / name.removeprefix("SEGLOC")
            known = extras(folder) if (folder / "pyproject.toml").is_file() else set()
            named = [each for each in (found[2] or "").split(",") if each]
            yield from (f"no extra {each!r} of {name}" for each in named if each not in known)
            if not folder.is_dir():
                yield f"no folder {name}"


def target_faults(arguments: str) -> Iterator[str]:
    """Why what ``make`` is given is none of its targets."""
    known = re.findall(r"^([a-z][\w-]*):", (PROJECT / "Makefile").read_text("utf-8"), re.MULTILINE)
    words = shlex.split(arguments)
    yield from (f"no target {word!r}" for word in words if "=" not in word and word not in known)


def wrong_commands(found: Iterator[Command]) -> list[str]:
    """The faults of commands, with their places."""
    root: Any = typer.main.get_command(app)
    missing = [verbs for one, verbs in BY_OTHERS.items() if one not in root.commands]
    unknown = set().union(*missing)
    return [
        f"{command.place}: segloc {' '.join(command.words)}: {fault}"
        for command in found
        if command.words[0] not in unknown
        for fault in faults(root, list(command.words), command.whole)
    ]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(PROJECT)))
def test_documented_commands_exist(path: Path) -> None:
    wrong = wrong_commands(commands(path))
    assert not wrong, "\n".join(wrong)


def test_commands_and_options_of_messages_exist() -> None:
    spans = (
        Command(place, tuple(_words(span)), whole=False)
        for path in SOURCES
        for place, text in messages(path)
        for span in _SPAN.findall(text)
    )
    wrong = wrong_commands(spans)
    known = all_options(typer.main.get_command(app))
    for path in PROGRAM:
        for place, text in messages(path):
            options = _OPTION.findall(_OTHER_PROGRAM.sub("", text))
            wrong += [f"{place}: no option {each}" for each in options if each not in known]
    assert not wrong, "\n".join(wrong)


def test_what_is_to_be_installed_or_made_exists() -> None:
    known = extras(PROJECT) | extras(PROJECT / "lab")
    wrong = []
    for place, text in texts():
        found = [fault for each in _PIP.findall(text) for fault in install_faults(each)]
        found += [fault for each in _MAKE.findall(text) for fault in target_faults(each)]
        named = [name for each in _EXTRAS.findall(text) for name in re.findall(r"[\w-]+", each)]
        found += [f"no extra {name!r}" for name in named if name not in {*known, "and"}]
        wrong += [f"{place}: {fault}" for fault in found]
    assert not wrong, "\n".join(wrong)


def test_make_demo_does_not_compile_what_pip_has_installed(tmp_path: Path) -> None:
    if shutil.which("make") is None:
        pytest.skip("no make here")
    planned = ["make", "--no-print-directory", "--dry-run", "demo", f"VENV={tmp_path}"]

    def plan() -> str:
        return subprocess.run(
            planned, cwd=PROJECT, capture_output=True, text=True, check=True
        ).stdout

    assert "pip install" in plan()
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "segloc").touch()
    assert plan().splitlines() == [f"{tmp_path}/bin/segloc demo --out demo"]


def test_a_missing_package_is_named_as_its_extra_declares_it() -> None:
    """The command of the message installs a version that segloc works with."""
    declared = metadata.requires("segloc") or []
    named = ("MissingDependency", "requires")
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in named:
                if not all(isinstance(each, ast.Constant) for each in node.args[:2]):
                    continue  # by ``requires`` itself
                package, extra = (ast.literal_eval(each) for each in node.args[:2])
                message = str(MissingDependency(package, extra, "this"))
                found = re.fullmatch(r".* pip install '(.*)'", message)
                assert found, message
                of_extra = f'{found[1]}; extra == "{extra}"'
                assert extra == "lab" or of_extra in declared, (path, node.lineno, message)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("segloc map build RUN --out a.segmap", None),
        ("segloc map destroy RUN", "no 'destroy'"),
        ("segloc map build RUN --outt a.segmap", "No such option"),
        ("segloc map build RUN", "Missing option"),
        ("segloc localize RUN --map a.segmap --every far", "Invalid value"),
    ],
)
def test_wrong_commands_are_seen(text: str, fault: str | None) -> None:
    found = faults(typer.main.get_command(app), _words(text)[1:], whole=True)
    assert (found == []) if fault is None else (fault in str(found))


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        ('".[io,ros]"', None),
        ("-c constraints.txt -e '.[dev]' -e ./lab", None),
        ("'.[evaluate]' -e ./lab", "no extra 'evaluate'"),
        ("segloc-lab", "not published"),
        ("'segloc[io]'", "not published"),
        ("./laboratory", "no folder"),
    ],
)
def test_wrong_installs_are_seen(arguments: str, fault: str | None) -> None:
    found = list(install_faults(arguments))
    assert (found == []) if fault is None else (fault in str(found))
    assert list(target_faults("test dmeo")) == ["no target 'dmeo'"]
