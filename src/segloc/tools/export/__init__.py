"""Export maps and results to formats of other software."""

from .formats import FORMATS as FORMATS
from .formats import export as export
