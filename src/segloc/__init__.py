"""segloc: where is the robot? A pose in a prior LiDAR map from one point cloud."""

from .errors import SeglocError as SeglocError
from .types import Localization as Localization
from .types import Scan as Scan
