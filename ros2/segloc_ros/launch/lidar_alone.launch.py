"""A robot with a LiDAR and nothing else: odometry from the clouds, map -> odom -> base_link.

ros2 launch segloc_ros lidar_alone.launch.py map:=/maps/site.segmap points:=/points
    [odom:=/odom] [namespace:=robot1] [pose_file:=...] [rviz:=true]

``odom`` is the topic on which the odometry is published. Further arguments are those of
segloc.launch.py.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

OURS = Path(get_package_share_directory("segloc_ros"))


def generate_launch_description() -> LaunchDescription:
    fixed = {"odometry": "kiss-icp", "mode": "tf", "trigger": "periodic"}
    segloc = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(OURS / "launch" / "segloc.launch.py")),
        launch_arguments=fixed.items(),
    )
    return LaunchDescription([segloc])
