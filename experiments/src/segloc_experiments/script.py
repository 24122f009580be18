"""What the modules that run as scripts share."""

from __future__ import annotations

import argparse


def parser(doc: str | None) -> argparse.ArgumentParser:
    """A parser that shows a module's docstring as its help."""
    return argparse.ArgumentParser(
        description=(doc or "").strip(), formatter_class=argparse.RawDescriptionHelpFormatter
    )


def head(*columns: str) -> str:
    """The head of a Markdown table."""
    return f"{row(*columns)}\n{row(*('---' for _ in columns))}"


def row(*cells: object) -> str:
    """A row of a Markdown table."""
    return f"| {' | '.join(map(str, cells))} |"
