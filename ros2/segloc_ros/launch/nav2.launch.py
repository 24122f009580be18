"""segloc and Nav2 with AMCL: segloc finds the robot, AMCL follows it from there.

ros2 launch segloc_ros nav2.launch.py map:=/maps/site.segmap grid:=/maps/site.yaml
    points:=/points odom:=/odom [namespace:=robot1] [params_file:=...] [nav2_params_file:=...]

Further arguments are those of segloc.launch.py.
"""

from launch import LaunchDescription
from segloc_ros.launching import nav2, nav2_arguments, segloc, share


def generate_launch_description() -> LaunchDescription:
    defaults = str(share("segloc_ros") / "config" / "nav2.yaml")
    node = segloc(default_params_file=defaults)
    return LaunchDescription([*nav2_arguments(), node, nav2()])
