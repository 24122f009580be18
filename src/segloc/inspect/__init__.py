"""Explain queries stage by stage, in text, pictures and a viewer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..system import lazy
from .trace import Part as Part
from .trace import Trace as Trace
from .trace import steps as steps
from .trace import summarize as summarize
from .trace import trace as trace

if TYPE_CHECKING:
    from .pictures import DARK as DARK
    from .pictures import GREEN as GREEN
    from .pictures import GREY as GREY
    from .pictures import ORANGE as ORANGE
    from .pictures import PALETTE as PALETTE
    from .pictures import PATH as PATH
    from .pictures import RED as RED
    from .pictures import blank as blank
    from .pictures import legend as legend
    from .pictures import plan as plan
    from .pictures import png as png
else:
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "pictures": "DARK GREEN ORANGE PALETTE PATH RED blank png GREY legend plan",
        },
    )
