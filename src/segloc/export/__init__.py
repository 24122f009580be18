"""Maps and results in the formats of others."""

from .formats import FORMATS as FORMATS
from .formats import export as export
