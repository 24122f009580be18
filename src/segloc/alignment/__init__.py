"""Several sessions of one place, each with drifting poses, brought into one frame."""

from ..reposed import Reposed as Reposed
from .align import Alignment as Alignment
from .align import align_sessions as align_sessions
from .config import AlignConfig as AlignConfig
from .loops import Loop as Loop
