"""Localization by stems, poles and columns, or by landmarks of any detector."""

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
