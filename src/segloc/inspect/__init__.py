"""One query through every stage: what was found, how sure, and why: words and pictures."""

from .trace import Part as Part
from .trace import Trace as Trace
from .trace import steps as steps
from .trace import trace as trace
from .trace import verdict as verdict
