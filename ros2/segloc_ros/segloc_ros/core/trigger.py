"""When to search for the robot, and near which prior."""

from __future__ import annotations

import math
from typing import Literal

from segloc import Prior
from segloc.live import State


class Trigger:
    """Whether queries are made; at rest the pose that was found follows the odometry.

    Parameters
    ----------
    kind : str
        ``periodic``: always. ``until_localized``: until the robot is found. ``service``: from a
        call until the robot is found.
    prior_s : float
        Time that a prior is used, from the first query on [s].

    Attributes
    ----------
    resting : bool
    held : State or None
        The state in which the robot was found before rest.
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
        """Search near a prior first, then anywhere, or with ``anywhere`` False not at all."""
        self.resting, self.held = False, None
        self._prior, self._until, self._anywhere = prior, math.inf, anywhere

    def check(self) -> None:
        """Search anywhere once more; the pose is held until it is found again."""
        held = self.held
        self.wake()
        self.held = held

    def near(self, stamp: float) -> Prior | None:
        """Return the prior of a query at a time; None for the whole map."""
        if self._prior is not None and math.isinf(self._until):
            self._until = stamp + self._prior_s
        if self._prior is not None and not self._until - self._prior_s <= stamp <= self._until:
            self._prior = None
            self.resting = not self._anywhere
        return self._prior

    def found(self, state: State) -> None:
        """Rest, unless periodic: the robot is localized."""
        self._prior = None
        if self.kind != "periodic":
            self.resting, self.held = True, state

    def lose(self) -> None:
        """Drop the pose, and search again if that needs no call."""
        self.held = None
        self.resting = self.kind == "service"
