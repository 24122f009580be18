"""Localize a moving robot online from scans and odometry."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..system import lazy
from ..tracking.belief import Status as Status
from .config import LiveConfig as LiveConfig
from .core import LiveCore as LiveCore
from .core import State as State
from .localizer import LiveLocalizer as LiveLocalizer

if TYPE_CHECKING:
    from .replay import Replay as Replay
    from .replay import play as play
    from .replay import pose_errors as pose_errors
else:
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "replay": "Replay play pose_errors",
        },
    )
