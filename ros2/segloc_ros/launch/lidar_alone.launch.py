"""A robot with a LiDAR and nothing else: odometry from the clouds, map -> odom -> base_link.

ros2 launch segloc_ros lidar_alone.launch.py map:=/maps/site.segmap points:=/points
    [odom:=/odom] [namespace:=robot1] [pose_file:=...] [rviz:=true]

``odom`` is the topic on which the odometry is published. Further arguments are those of
segloc.launch.py.
"""

from launch import LaunchDescription
from segloc_ros.launching import segloc


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([segloc(odometry="kiss-icp", mode="tf", trigger="periodic")])
