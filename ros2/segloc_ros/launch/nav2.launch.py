"""segloc and Nav2 with AMCL: segloc finds the robot, AMCL follows it from there.

ros2 launch segloc_ros nav2.launch.py map:=/maps/site.segmap grid:=/maps/site.yaml
    points:=/points odom:=/odom [namespace:=robot1] [nav2_params_file:=...]

Further arguments are those of segloc.launch.py.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PythonExpression

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
        launch_arguments={"params_file": str(OURS / "config" / "nav2.yaml")}.items(),
    )
    bringup = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(NAV2 / "launch" / "bringup_launch.py")),
        launch_arguments={
            "map": given["grid"],
            "params_file": given["nav2_params_file"],
            "namespace": given["namespace"],
            "use_namespace": PythonExpression(["'", given["namespace"], "' != ''"]),
            "use_sim_time": given["use_sim_time"],
        }.items(),
    )
    return LaunchDescription([*declared, GroupAction([segloc]), GroupAction([bringup])])
