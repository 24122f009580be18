"""A robot followed while it drives: scans and odometry in, where it is in the map out."""

from ..tracking.views import Status as Status
from .config import LiveConfig as LiveConfig
from .core import LiveCore as LiveCore
from .core import State as State
from .localizer import LiveLocalizer as LiveLocalizer
