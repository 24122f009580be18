"""Every command in the documents is one that the command line takes; none is run."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer
from samples.documents import code, documents
from samples.source import PROJECT

from segloc.cli import app

BY_EXPERIMENTS = {"bench", "evaluate"}
"""Verbs that segloc-lab adds, or adds to: unknown parts are its where it is missing."""

_FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
_SPAN = re.compile(r"`segloc ([^`]+)`")
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


@pytest.mark.parametrize("path", documents(), ids=lambda path: str(path.relative_to(PROJECT)))
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
