"""segloc and Nav2 without AMCL: segloc broadcasts map -> odom, without jumps.

ros2 launch segloc_ros nav2_without_amcl.launch.py map:=/maps/site.segmap grid:=/maps/site.yaml
    points:=/points odom:=/odom [namespace:=robot1] [odometry:=kiss-icp] [pose_file:=...]

Further arguments are those of segloc.launch.py.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

OURS = Path(get_package_share_directory("segloc_ros"))
NAV2 = Path(get_package_share_directory("nav2_bringup"))


def generate_launch_description() -> LaunchDescription:
    names = ("namespace", "grid", "nav2_params_file", "use_sim_time")
    given = {name: LaunchConfiguration(name) for name in names}
    declared = [
        DeclareLaunchArgument("grid", description="Nav2's map.yaml, in the frame of the map"),
        DeclareLaunchArgument(
            "nav2_params_file", default_value=str(NAV2 / "params" / "nav2_params.yaml")
        ),
        DeclareLaunchArgument("namespace", default_value=""),
        DeclareLaunchArgument("use_sim_time", default_value="false"),
    ]
    segloc = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(OURS / "launch" / "segloc.launch.py")),
        launch_arguments={"mode": "tf", "trigger": "periodic", "smooth_tf": "true"}.items(),
    )
    navigation = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(NAV2 / "launch" / "navigation_launch.py")),
        launch_arguments={
            "params_file": given["nav2_params_file"],
            "namespace": given["namespace"],
            "use_sim_time": given["use_sim_time"],
        }.items(),
    )
    clock = {"use_sim_time": given["use_sim_time"]}
    server = Node(
        package="nav2_map_server",
        executable="map_server",
        name="map_server",
        namespace=given["namespace"],
        parameters=[clock, {"yaml_filename": given["grid"]}],
    )
    manager = Node(
        package="nav2_lifecycle_manager",
        executable="lifecycle_manager",
        name="lifecycle_manager_map",
        namespace=given["namespace"],
        parameters=[clock, {"autostart": True, "node_names": ["map_server"]}],
    )
    groups = [GroupAction([segloc]), server, manager, GroupAction([navigation])]
    return LaunchDescription([*declared, *groups])
