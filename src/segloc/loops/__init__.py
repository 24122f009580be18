"""Sessions with drifting poses, brought into one frame, or into that of a map."""

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
