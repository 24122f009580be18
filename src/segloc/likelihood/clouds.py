"""What a scorer needs of the cloud of a map, in one piece or in tiles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from ..frontend.segmentation import Segmentation
from ..localization import NextView
from ..types import Pose
from .observation import Aligned, Observation, QueryCloud, Walls


class Clouds(Protocol):
    """Compares query clouds with the map at poses T_map_local; see MapCloud."""

    def query(self, scene: Segmentation) -> QueryCloud: ...

    def rough_overlap(self, poses: Sequence[Pose], query: QueryCloud) -> list[float]: ...

    def around(self, T_map_local: Pose, query: QueryCloud) -> list[Pose]: ...

    def aligned(
        self, T_map_local: Pose, query: QueryCloud, known: Pose | None = None
    ) -> Aligned: ...

    def measured(
        self,
        T_map_local: Pose,
        query: QueryCloud,
        known: Pose | None = None,
        *,
        align: bool = True,
    ) -> Observation: ...

    def walls(self, T_map_local: Pose, query: QueryCloud) -> Walls: ...

    def finest(self, fit: Observation, query: QueryCloud) -> Observation: ...

    def next_view(self, T_one: Pose, T_other: Pose) -> NextView | None: ...
