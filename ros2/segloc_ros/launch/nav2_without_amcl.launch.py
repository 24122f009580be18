"""segloc and Nav2 without AMCL: segloc broadcasts map -> odom, without jumps, under AMCL's names.

ros2 launch segloc_ros nav2_without_amcl.launch.py map:=/maps/site.segmap grid:=/maps/site.yaml
    points:=/points odom:=/odom [namespace:=robot1] [odometry:=kiss-icp] [pose_file:=...]

Further arguments are those of segloc.launch.py.
"""

from launch import LaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from segloc_ros.launching import nav2, nav2_arguments, segloc


def generate_launch_description() -> LaunchDescription:
    namespace = LaunchConfiguration("namespace")
    clock = {"use_sim_time": LaunchConfiguration("use_sim_time")}
    server = Node(
        package="nav2_map_server",
        executable="map_server",
        name="map_server",
        namespace=namespace,
        parameters=[clock, {"yaml_filename": LaunchConfiguration("grid")}],
    )
    manager = Node(
        package="nav2_lifecycle_manager",
        executable="lifecycle_manager",
        name="lifecycle_manager_map",
        namespace=namespace,
        parameters=[clock, {"autostart": True, "node_names": ["map_server"]}],
    )
    node = segloc(mode="tf", trigger="periodic", smooth_tf="true", amcl_names="true")
    navigation = nav2(use_localization="False")
    return LaunchDescription([*nav2_arguments(), node, server, manager, navigation])
