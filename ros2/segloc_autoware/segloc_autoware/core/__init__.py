"""What the service means, without ROS."""

from .align import Aligned as Aligned
from .align import aligned as aligned
from .align import prior_of as prior_of
