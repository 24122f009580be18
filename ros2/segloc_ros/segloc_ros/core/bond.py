"""One end of a bond with a lifecycle manager: heartbeats in both directions, as bondcpp's."""

from __future__ import annotations

import uuid

PERIOD_S = 0.25
"""Time between heartbeats [s]; Nav2's nodes send four to ten per second."""
TIMEOUT_S = 4.0
"""Time without heartbeats of the other end after which a bond is broken [s]."""


class Bond:
    """Whether the other end lives, by its heartbeats.

    Attributes
    ----------
    instance : str
        Identity of this end.
    is_broken : bool
        Whether the other end has ended, or fell silent. A broken bond stays broken.
    """

    def __init__(self) -> None:
        self.instance = str(uuid.uuid4())
        self.is_broken = False
        self._other = ""
        self._received_s = 0.0

    def receive(self, instance: str, active: bool, now_s: float) -> None:
        """Take a heartbeat, or the message of an end, by a steady clock.

        Those of this end, which come back, and of a third one are ignored.
        """
        if instance == self.instance or self._other not in ("", instance):
            return
        self._other, self._received_s = instance, now_s
        self.is_broken = self.is_broken or not active

    def check(self, now_s: float) -> None:
        """Break the bond if the other end fell silent; it may begin at any time."""
        if self._other and now_s - self._received_s > TIMEOUT_S:
            self.is_broken = True
