"""``python -m segloc``: the command line."""

from .tools.cli import main

main()
