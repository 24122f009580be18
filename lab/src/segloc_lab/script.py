"""Command lines of scripts. The standard library alone: other systems' environments import it."""

from __future__ import annotations

import argparse


def parser(doc: str | None) -> argparse.ArgumentParser:
    """Make a parser that shows a module's docstring as its help."""
    return argparse.ArgumentParser(
        description=(doc or "").strip(), formatter_class=argparse.RawDescriptionHelpFormatter
    )
