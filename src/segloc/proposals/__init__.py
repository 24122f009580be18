"""Candidate poses of a query: first sight, segments and occupancy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..system import lazy

if TYPE_CHECKING:
    from .first_sight import FirstSight as FirstSight
    from .matching import Matcher as Matcher
    from .matching import MatchingConfig as MatchingConfig
    from .pose import PoseConfig as PoseConfig
    from .pose import PoseEstimator as PoseEstimator
    from .proposer import Estimator as Estimator
    from .proposer import Query as Query
else:
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "first_sight": "FirstSight",
            "matching": "Matcher MatchingConfig",
            "pose": "PoseConfig PoseEstimator",
            "proposer": "Estimator Query",
        },
    )
