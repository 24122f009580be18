"""Format numbers in sentences, and errors on a line."""

from __future__ import annotations

import json
from typing import Any

_COLUMNS = 100


def quantity(count: int, noun: str, verb: str = "") -> str:
    """Format a count with its noun and its verb: "1 segment agrees", "2 segments agree".

    Parameters
    ----------
    count : int
    noun, verb : str
        In the plural of the noun, and of the regular verb.
    """
    words = f"{count} {noun}" if count != 1 else f"1 {_singular(noun)}"
    return f"{words} {verb if count != 1 else verb + 's'}" if verb else words


def _singular(noun: str) -> str:
    return noun[:-3] + "y" if noun.endswith("ies") else noun.removesuffix("s")


def number(value: float | None, unit: str = "", digits: int = 2) -> str:
    """Format a number with its unit, or a dash for None."""
    return "-" if value is None else f"{value:.{digits}f}{unit and ' ' + unit}"


def one_line(error: object) -> str:
    """Return the message of an error on one line, or its name if it has none."""
    return " ".join(str(error).split()) or type(error).__name__


def json_text(value: Any, before: int = 0, indent: int = 0) -> str:
    """Format a value as JSON in lines of at most 100 columns, except for longer texts.

    Parameters
    ----------
    value : JSON value
        Finite numbers only.
    before : int
        Columns in use on the first line.
    indent : int
        Columns before the last line.
    """
    text = json.dumps(value, ensure_ascii=False, allow_nan=False)
    if before + len(text) < _COLUMNS or not isinstance(value, (dict, list)):
        return text
    if isinstance(value, dict):
        named = [(f"{json.dumps(key, ensure_ascii=False)}: ", each) for key, each in value.items()]
    else:
        named = [("", each) for each in value]
    inner = indent + 2
    lines: list[str] = []
    for name, each in named:
        item = f"{name}{json_text(each, inner + len(name), inner)}"
        filled = f"{lines[-1]}, {item}" if lines else item
        if lines and "\n" not in filled and inner + len(filled) < _COLUMNS:
            lines[-1] = filled
        else:
            lines.append(item)
    open_, close = "{}" if isinstance(value, dict) else "[]"
    space = " " * inner
    return f"{open_}\n{space}" + f",\n{space}".join(lines) + f"\n{' ' * indent}{close}"
