"""Candidate poses of a query: segments, stems and occupancy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..system import lazy

if TYPE_CHECKING:
    from .landmarks import LandmarkConfig as LandmarkConfig
    from .landmarks import LandmarkLocalizer as LandmarkLocalizer
    from .landmarks import LandmarkMap as LandmarkMap
    from .landmarks import LandmarkMapper as LandmarkMapper
    from .landmarks import Landmarks as Landmarks
    from .landmarks import StemFinder as StemFinder
    from .landmarks import find_stems as find_stems
    from .landmarks import levelling as levelling
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
            "landmarks": "LandmarkConfig LandmarkLocalizer LandmarkMap LandmarkMapper "
            "Landmarks StemFinder find_stems levelling",
            "matching": "Matcher MatchingConfig",
            "pose": "PoseConfig PoseEstimator",
            "proposer": "Estimator Query",
        },
    )
