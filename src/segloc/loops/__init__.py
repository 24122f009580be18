"""Align sessions with drifting poses, to each other or to a map."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..system import lazy
from ..types import Reposed as Reposed
from .align import Alignment as Alignment
from .align import align_sessions as align_sessions
from .config import AlignConfig as AlignConfig
from .detector import LoopClosure as LoopClosure
from .detector import LoopConfig as LoopConfig
from .detector import LoopDetector as LoopDetector
from .loops import Loop as Loop
from .to_map import MapAlignment as MapAlignment
from .to_map import align_to_map as align_to_map

if TYPE_CHECKING:
    from .graph import Edges as Edges
    from .graph import concatenate_edges as concatenate_edges
    from .graph import solve_robustly as solve_robustly
else:
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "graph": "Edges concatenate_edges solve_robustly",
        },
    )
