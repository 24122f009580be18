"""Local cloud -> candidate poses, by occupancy: for queries whose segments say too little.

The map and the query are looked at from above: which cells are occupied, at which heights over
ground. Poses are searched by branch and bound over windows that hold all that their cells do. W.
Hess, D. Kohler, H. Rapp, D. Andor, "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016, search
maps of one floor so; here a cell has several heights, and the work is bounded.
"""

from .config import OccupancyConfig as OccupancyConfig
from .search import OccupancyProposer as OccupancyProposer
from .storeys import is_storeyed as is_storeyed
