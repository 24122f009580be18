"""segloc and Nav2: segloc finds the robot, AMCL follows it from there.

ros2 launch segloc_ros nav2.launch.py map:=/maps/site.segmap grid:=/maps/site.yaml
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration


def generate_launch_description() -> LaunchDescription:
    ours = Path(get_package_share_directory("segloc_ros"))
    nav2 = Path(get_package_share_directory("nav2_bringup"))
    given = {
        name: LaunchConfiguration(name)
        for name in ("map", "grid", "nav2_params_file", "use_sim_time")
    }
    declared = [
        DeclareLaunchArgument("map", description="the .segmap"),
        DeclareLaunchArgument("grid", description="Nav2's map.yaml, in the same frame"),
        DeclareLaunchArgument(
            "nav2_params_file", default_value=str(nav2 / "params" / "nav2_params.yaml")
        ),
        DeclareLaunchArgument("use_sim_time", default_value="false"),
    ]
    segloc = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(ours / "launch" / "segloc.launch.py")),
        launch_arguments={
            "map": given["map"],
            "params_file": str(ours / "config" / "nav2.yaml"),
            "use_sim_time": given["use_sim_time"],
        }.items(),
    )
    bringup = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(nav2 / "launch" / "bringup_launch.py")),
        launch_arguments={
            "map": given["grid"],
            "params_file": given["nav2_params_file"],
            "use_sim_time": given["use_sim_time"],
        }.items(),
    )
    return LaunchDescription([*declared, segloc, bringup])
