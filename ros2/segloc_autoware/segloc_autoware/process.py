"""The process of the node."""

from __future__ import annotations

from typing import TYPE_CHECKING

from segloc_ros.process import start

if TYPE_CHECKING:
    from .node import AlignNode


def main() -> None:
    """Run the node of segloc_autoware."""

    def load() -> type[AlignNode]:
        from .node import AlignNode

        return AlignNode

    start(load)
