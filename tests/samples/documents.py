"""The code of the documents: blocks of Python, and commands of a shell."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from .source import PROJECT

SHELL = {"", "bash", "sh", "shell"}
_PROMPT = re.compile(
    r"(SEGLOC_\w+|segloc|python3?|pip|make|git|cd|ros2|docker|for|done|\S+\.sh)\b|[A-Z]=|\. "
)


class Code(NamedTuple):
    """A block of Python, or one command of a shell, its continued lines joined."""

    place: str
    language: str
    text: str


def documents() -> list[Path]:
    """The README and all pages of the documentation, those of decisions too."""
    return [PROJECT / "README.md", *sorted((PROJECT / "docs").rglob("*.md"))]


def blocks(path: Path) -> Iterator[Code]:
    """Fenced blocks, and indented ones as such without a language."""
    name = path.relative_to(PROJECT)
    language, begin, lines = None, 0, list[str]()
    for number, line in enumerate([*path.read_text("utf-8").splitlines(), ""], 1):
        indented = line.startswith("    ") and (
            language is not None or not line[4:].startswith(" ")
        )
        if line.lstrip().startswith("```"):
            if language is not None:
                yield Code(f"{name}:{begin}", language, "\n".join(lines))
                language = None
            else:
                language, begin, lines = line.strip()[3:].strip(), number + 1, []
        elif language is not None and language != "indented":
            lines.append(line)
        elif indented and not re.match(r" *([-*|]|\d+\.) ", line):
            if language is None:
                language, begin, lines = "indented", number, []
            lines.append(line[4:])
        elif language == "indented":
            yield Code(f"{name}:{begin}", "", "\n".join(lines))
            language = None


def code(path: Path) -> Iterator[Code]:
    """Blocks of Python, and the commands of those of a shell one by one."""
    for block in blocks(path):
        if block.language == "python":
            yield block
        elif block.language in SHELL and _PROMPT.match(block.text.strip()):
            yield from _commands(block)


def _commands(block: Code) -> Iterator[Code]:
    name, _, first = block.place.rpartition(":")
    before, begin = "", 0
    for number, line in enumerate(block.text.splitlines(), int(first)):
        begin = begin or number
        if line.endswith("\\"):
            before += line[:-1]
            continue
        text = re.sub(r"(^|\s)#\s.*", "", before + line).strip()
        if text:
            yield Code(f"{name}:{begin}", "shell", text)
        before, begin = "", 0
