"""When the robot is looked for, and near what."""

from __future__ import annotations

import math
from typing import Literal

from segloc import Prior
from segloc.live import State


class Trigger:
    """Awake it looks for the robot; at rest what was found holds, by odometry alone.

    Parameters
    ----------
    kind : str
        ``periodic``: always awake. ``until_localized``: until it is found. ``service``: only from
        a call until it is found.
    prior_s : float
        So long a prior counts, seconds from the first query on.

    Attributes
    ----------
    resting : bool
    held : State or None
        What was found before it came to rest.
    """

    def __init__(
        self, kind: Literal["until_localized", "periodic", "service"], prior_s: float
    ) -> None:
        self.kind, self._prior_s = kind, prior_s
        self.resting = kind == "service"
        self.held: State | None = None
        self._prior: Prior | None = None
        self._until = math.inf
        self._anywhere = True

    def wake(self, prior: Prior | None = None, anywhere: bool = True) -> None:
        """Look for it: near a prior first, then anywhere, or not at all."""
        self.resting, self.held = False, None
        self._prior, self._until, self._anywhere = prior, math.inf, anywhere

    def near(self, stamp: float) -> Prior | None:
        """Where alone a query of that time may look; None: anywhere."""
        if self._prior is not None and math.isinf(self._until):
            self._until = stamp + self._prior_s
        if self._prior is not None and stamp > self._until:
            self._prior = None
            self.resting = not self._anywhere
        return self._prior

    def found(self, state: State) -> None:
        """It is localized."""
        self._prior = None
        if self.kind != "periodic":
            self.resting, self.held = True, state

    def lose(self) -> None:
        """What was found holds no longer: look again, where that is allowed without a call."""
        self.held = None
        self.resting = self.kind == "service"
