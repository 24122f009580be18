"""Every command in the documents is one that the command line takes; none is run."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer
from samples.source import PROJECT

from segloc.cli import app

BY_EXPERIMENTS = {"bench", "evaluate"}
"""Verbs that segloc-lab adds, or adds to: unknown parts are its where it is missing."""

_SPAN = re.compile(r"`segloc ([^`]+)`")
_ALTERNATIVES = re.compile(r"[\w-]+(\|[\w-]+)+")


class Command(NamedTuple):
    """A command as documented. A whole one has all its arguments, others only names."""

    place: str
    words: tuple[str, ...]
    whole: bool


def commands(path: Path) -> Iterator[Command]:
    """Lines of code blocks that begin with ``segloc``, and spans of code that do."""
    fenced, before = False, ""
    for number, part in enumerate(path.read_text("utf-8").splitlines(), 1):
        line, before = before + part, ""
        if line.endswith("\\"):
            before = line[:-1]
            continue
        place = f"{path.relative_to(PROJECT)}:{number}"
        if line.startswith("```"):
            fenced = not fenced
        elif fenced or line.startswith("    "):
            if line.strip().startswith("segloc "):
                yield Command(place, tuple(_words(line)[1:]), whole=True)
        else:
            yield from (
                Command(place, tuple(_words(found[1])), whole=False)
                for found in _SPAN.finditer(line)
            )


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


DOCUMENTS = [PROJECT / "README.md", *sorted((PROJECT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(PROJECT)))
def test_documented_commands_exist(path: Path) -> None:
    root: Any = typer.main.get_command(app)
    complete = "bench" in root.commands
    wrong = []
    for command in commands(path):
        found = faults(root, list(command.words), command.whole)
        if complete or command.words[0] not in BY_EXPERIMENTS:
            wrong += [f"{command.place}: segloc {' '.join(command.words)}: {f}" for f in found]
    assert not wrong, "\n".join(wrong)


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
