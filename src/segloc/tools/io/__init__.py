"""Read and write point clouds and trajectories."""

from .pose_files import read_trajectory as read_trajectory
from .scans import read_scan as read_scan
from .scans import write_scan as write_scan
from .trajectory import Trajectory as Trajectory
from .trajectory import tum_text as tum_text
from .trajectory import write_kitti as write_kitti
from .trajectory import write_tum as write_tum
