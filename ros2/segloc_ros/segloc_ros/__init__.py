"""segloc on a robot under ROS 2: ``core`` knows nothing of ROS, the rest is its node."""
