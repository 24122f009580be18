"""``python -m segloc``: the command line."""

from .cli import main

main()
