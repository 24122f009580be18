"""Format numbers in sentences."""

from __future__ import annotations


def counted(count: int, noun: str, verb: str = "") -> str:
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
