"""What ``segloc live`` writes while it runs, for ``segloc view`` to follow; gone when it ends."""

from __future__ import annotations

import json
import time
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

if TYPE_CHECKING:
    from ..live import State
    from ..types import Recording

_EVERY_S = 1.0
_VOXEL_M = 0.3


class SoFar:
    """Keeps the states so far and the newest scan in a folder until the results are there.

    Parameters
    ----------
    out : path
        Made with the first state.
    recording : Recording
    clouds : bool
        Whether scans can be read meanwhile, from the thread that adds states.
    """

    def __init__(self, out: Path, recording: Recording, clouds: bool = True) -> None:
        from ..inspect.following import NEWEST, SO_FAR

        self._states, self._newest = out / SO_FAR, out / NEWEST
        self._recording, self._clouds = recording, clouds
        self._stream: TextIO | None = None
        self._last = -np.inf

    def __enter__(self) -> SoFar:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._stream is not None:
            self._stream.close()
            for file in (self._states, self._newest):
                file.unlink(missing_ok=True)

    def add(self, position: int, state: State) -> None:
        """One more state; now and then with what stands in its scan."""
        if self._stream is None:
            self._states.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self._states.open("w", encoding="utf-8")
        self._stream.write(json.dumps(record(self._recording, position, state)) + "\n")
        self._stream.flush()
        if self._clouds and time.monotonic() - self._last > _EVERY_S:
            self._last = time.monotonic()
            self._keep(position, state)

    def _keep(self, position: int, state: State) -> None:
        from .. import _native, geometry
        from ..system.files import replacing

        T = state.T_map_base
        if T is None:
            self._newest.unlink(missing_ok=True)
            return
        points = geometry.transform(T, self._recording.scan(position).points)
        origin = points.mean(axis=0) if len(points) else np.zeros(3)
        local = np.ascontiguousarray(points - origin, dtype=np.float32)
        thinned = _native.voxel_grid(local, _VOXEL_M).astype(np.float64) + origin
        with replacing(self._newest) as stream:
            np.save(stream, thinned)


def record(recording: Recording, position: int, state: State) -> dict[str, Any]:
    """A state in values that JSON can hold, with the number and time of its scan."""
    return {
        "index": int(recording.indices[position]),
        **state.record(),
        "stamp": None if recording.stamps is None else float(recording.stamps[position]),
    }
