"""Which of Ouster's packets make a turn."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ...types import Float64, Int64
from .ouster_packets import Sensor

_FEWEST_PACKETS = 8  # of a turn; less is left from where the recording begins or ends


@dataclass(frozen=True)
class Turns:
    """Where the packets of each of T turns are.

    Attributes
    ----------
    numbers : (T,) int64
        What their packets are numbered by.
    stamps : (T,) float64
        When the first packet was recorded.
    firsts, stops : (T,) int64
        Where the first packet is, and behind the last.
    notes : tuple of str
    """

    numbers: Int64
    stamps: Float64
    firsts: Int64
    stops: Int64
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.numbers)


@dataclass
class _Turn:
    number: int
    stamp: float
    first: int
    stop: int
    packets: int = 1


def gather(packets: Iterable[tuple[int, float, int, int]], sensor: Sensor) -> Turns:
    """The turns of packets, each a number, a stamp, and where it begins and ends.

    A packet that comes late is counted to the turn before. Turns of which only a few packets are
    there are left out, such as those in which the recording begins and ends.
    """
    turns: list[_Turn] = []
    for number, stamp, first, stop in packets:
        turn = next((turn for turn in turns[:-3:-1] if turn.number == number), None)
        if turn is None:
            turns.append(_Turn(number, stamp, first, stop))
        else:
            turn.stop, turn.packets = max(turn.stop, stop), turn.packets + 1
    wanted = sensor.columns // sensor.packet["columns"].shape[0]
    kept = [turn for turn in turns if turn.packets >= min(_FEWEST_PACKETS, wanted)]
    missing = sum(turn.packets < wanted for turn in kept[1:-1])
    return Turns(
        np.array([turn.number for turn in kept], np.int64),
        np.array([turn.stamp for turn in kept], np.float64),
        np.array([turn.first for turn in kept], np.int64),
        np.array([turn.stop for turn in kept], np.int64),
        (f"{missing} of {len(kept)} turns miss packets",) if missing else (),
    )
