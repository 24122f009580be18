"""What is measured at a refined pose when the verdict first asks for it: most are never asked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from .. import _native
from ..registration import Target
from ..types import Pose
from .config import VerificationConfig
from .walls import flush_share, ground_share


class Query(Protocol):
    """What is compared with the map."""

    @property
    def surface(self) -> _native.Surface: ...
    @property
    def close_surface(self) -> _native.Surface: ...


@dataclass(frozen=True)
class ComparedMap:
    """What a query is compared with.

    Attributes
    ----------
    target : Target
        The map's cloud.
    close : Surface
        Of the same, of :func:`segloc.verification.walls.close_surface`.
    """

    target: Target
    close: _native.Surface


class MeasuredDetails:
    """How walls and ground fit at a pose; each is measured once, when it is needed.

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
