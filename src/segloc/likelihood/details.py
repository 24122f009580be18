"""What is measured at a refined pose when the verdict first asks for it: most are never asked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from .. import _native
from ..types import Float32, Float64, Pose
from .config import VerificationConfig
from .intrusion import intruding_share
from .registration import Target
from .walls import flush_share, ground_share


class Query(Protocol):
    """What is compared with the map."""

    @property
    def surface(self) -> _native.Surface: ...
    @property
    def close_surface(self) -> _native.Surface: ...

    sample: Float32
    """(N, 3), of what stands."""


@dataclass(frozen=True)
class ComparedMap:
    """What a query is compared with.

    Attributes
    ----------
    target : Target
        The map's cloud.
    close : Surface
        Of the same, of :func:`segloc.likelihood.walls.close_surface`.
    path : (M, 3) float64
        Where the sensor was when the map was made, in the frame of the cloud.
    """

    target: Target
    close: _native.Surface
    path: Float64


class MeasuredDetails:
    """How walls, ground and free space fit at a pose; each is measured once, when it is needed.

    Parameters
    ----------
    compared : ComparedMap
    query : Query
    T : (4, 4) float64
        Takes the query to the frame of the map's cloud.
    config : VerificationConfig
    """

    def __init__(
        self, compared: ComparedMap, query: Query, T: Pose, config: VerificationConfig
    ) -> None:
        self._map, self._query, self._T, self._config = compared, query, T, config
        self._ground: tuple[float | None] | None = None
        self._flush: tuple[float | None] | None = None
        self._intruding: float | None = None

    @property
    def ground(self) -> float | None:
        """The share of the ground that lies on the map's."""
        if self._ground is None:
            surface = self._map.target.surface
            self._ground = (ground_share(surface, self._query.surface, self._T),)
        return self._ground[0]

    @property
    def flush(self) -> float | None:
        """The share of wall points that are flush with the map's surfaces, of those near them."""
        if self._flush is None:
            source, offset = self._query.close_surface, self._config.flush_offset
            self._flush = (flush_share(self._map.close, source, self._T, offset),)
        return self._flush[0]

    @property
    def intruding(self) -> float:
        """The share of what stands that stands in free space of the map."""
        if self._intruding is None:
            index, sample = self._map.target.index, self._query.sample
            self._intruding = intruding_share(index, sample, self._T, self._map.path, self._config)
        return self._intruding
