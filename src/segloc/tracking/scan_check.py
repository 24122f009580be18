"""Whether the newest scan shows what the map has where the robot is taken to be."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np
from pydantic import Field

from .. import geometry
from ..frontend.local_cloud import Scans
from ..frontend.segmentation import Segmentation
from ..likelihood import RefinedScore
from ..localizer import Localizer
from ..system.section import Section
from ..types import Candidate, Float64, LocalCloud, Pose, Scan
from .views import Check


class ScanCheckConfig(Section):
    """What a single scan must show at a pose to speak for it, or against it.

    Single scans at their true poses in KITTI 00 and in a corridor are at least 0.999 likely, and
    see 0.82 of the map in view; at other places of the map they are at most 0.011 likely, and see
    0.15 to 0.94.
    """

    holds_from: float = Field(0.98, ge=0, le=1, description="a scan this likely holds the track")
    contradicts_to: float = Field(
        0.05, ge=0, le=1, description="a scan no likelier shows another place, or none of the map"
    )
    contradicts_seen: float = Field(
        0.75, ge=0, le=1, description="it contradicts where no more of the map in view is seen"
    )
    least_judged: int = Field(
        100, ge=1, description="with fewer map points in view there is nothing to contradict"
    )


class ScanCheck:
    """Compares one scan with the map at one pose: no search, no rivals.

    Parameters
    ----------
    localizer : Localizer
    config : ScanCheckConfig, optional
    """

    def __init__(self, localizer: Localizer, config: ScanCheckConfig | None = None) -> None:
        self._localizer, self.config = localizer.in_one_piece(), config or ScanCheckConfig()

    def scene(self, scan: Scan | LocalCloud) -> tuple[LocalCloud, Segmentation]:
        """A scan as it is compared."""
        cloud = scan
        if isinstance(cloud, Scan):
            cloud = self._localizer.accumulator.gather(cloud)
        return cloud, self._localizer.segmenter.segment(cloud)

    def at(
        self, cloud: LocalCloud, scene: Segmentation, T_map_sensor: Pose
    ) -> tuple[Check, Pose, Float64 | None]:
        """What a scan says of a pose.

        Returns
        -------
        Check
        (4, 4) float64
            T_map_sensor where the clouds fit best, near the given one.
        (6, 6) float64 or None
            Its covariance, as :attr:`segloc.Localized.covariance`.
        """
        verifier, T_local_sensor = self._localizer.verifier, cloud.T_local_sensor
        T_map_local = T_map_sensor @ geometry.inverse(T_local_sensor)
        found = verifier.refined(Candidate(T_map_local, 0), verifier.query(scene))
        covariance = geometry.rotated_covariance(found.covariance, T_local_sensor)
        return self._said(found), found.T_map_local @ T_local_sensor, covariance

    def _said(self, found: RefinedScore) -> Check:
        config, seen = self.config, found.seen
        likely = self._localizer.verifier.model.standalone(found)
        if likely >= config.holds_from and found.covariance is not None:
            return Check.HOLDS
        if likely > config.contradicts_to:
            return Check.UNDECIDED
        looked_through = seen is not None and seen <= config.contradicts_seen
        if looked_through and found.judged >= config.least_judged:
            return Check.CONTRADICTS
        return Check.UNMAPPED


def newest_alone(scans: Scans | LocalCloud, T_odom_sensor: Pose) -> Scan | LocalCloud | None:
    """What shows no other place than that of the last scan, if anything is known to."""
    if isinstance(scans, LocalCloud):
        return scans
    if isinstance(scans, Sequence):
        return scans[-1] if scans and isinstance(scans[-1], Scan) else None
    if not isinstance(scans, (Scan, np.ndarray)):
        return None
    newest = Scan(scans) if isinstance(scans, np.ndarray) else copy.copy(scans)
    newest.T_odom_sensor = T_odom_sensor
    return newest
