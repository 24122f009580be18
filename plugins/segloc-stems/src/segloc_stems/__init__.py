"""Localization by stems, poles and columns, or by landmarks of any detector."""

from __future__ import annotations

from typing import TYPE_CHECKING

from segloc.system import lazy

if TYPE_CHECKING:
    from .config import LandmarkConfig as LandmarkConfig
    from .landmark_map import LandmarkMap as LandmarkMap
    from .landmark_map import LandmarkMapper as LandmarkMapper
    from .landmarks import Landmarks as Landmarks
    from .landmarks import levelling as levelling
    from .localizer import LandmarkLocalizer as LandmarkLocalizer
    from .proposer import StemProposer as StemProposer
    from .stems import StemFinder as StemFinder
    from .stems import Stems as Stems
    from .stems import find_stems as find_stems
else:  # the command line imports the package for its verbs
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "config": "LandmarkConfig",
            "landmark_map": "LandmarkMap LandmarkMapper",
            "landmarks": "Landmarks levelling",
            "localizer": "LandmarkLocalizer",
            "proposer": "StemProposer",
            "stems": "StemFinder Stems find_stems",
        },
    )
