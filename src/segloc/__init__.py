"""segloc: where is the robot? A pose in a prior LiDAR map from one point cloud.

>>> from segloc import Localizer, Scan, SegmentMap
>>> localizer = Localizer(SegmentMap.load("site.segmap"))  # doctest: +SKIP
>>> result = localizer.localize(Scan(points))  # doctest: +SKIP
"""

from ._native import __version__ as __version__
from .config import Config as Config
from .errors import ConfigError as ConfigError
from .errors import DatasetError as DatasetError
from .errors import InvalidScan as InvalidScan
from .errors import MapFormatError as MapFormatError
from .errors import MapMismatch as MapMismatch
from .errors import MissingDependency as MissingDependency
from .errors import SeglocError as SeglocError
from .errors import WeightsError as WeightsError
from .localizer import Localizer as Localizer
from .map.build import build_map as build_map
from .map.segment_map import SegmentMap as SegmentMap
from .types import Localization as Localization
from .types import Scan as Scan
