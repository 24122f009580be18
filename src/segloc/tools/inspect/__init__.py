"""Explain queries stage by stage, in text, pictures and a viewer."""

from __future__ import annotations

from .evidence import Part as Part
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
from .trace import Trace as Trace
from .trace import confidence_tables as confidence_tables
from .trace import steps as steps
from .trace import summarize as summarize
from .trace import trace as trace
