"""ros2 launch segloc_ros segloc.launch.py map:=/maps/site.segmap [params_file:=...] [rviz:=true]"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node


def generate_launch_description() -> LaunchDescription:
    share = Path(get_package_share_directory("segloc_ros"))
    arguments = {
        "map": ("", "the .segmap"),
        "params_file": (str(share / "config" / "segloc.yaml"), "parameters"),
        "points": ("points", "the topic of the clouds"),
        "odom": ("odom", "the topic of the odometry"),
        "mode": ("initialpose", "initialpose, tf or both"),
        "trigger": ("until_localized", "until_localized, periodic or service"),
        "use_sim_time": ("false", "for a bag or a simulator"),
        "rviz": ("false", "whether to show it"),
    }
    given = {name: LaunchConfiguration(name) for name in arguments}
    node = LifecycleNode(
        package="segloc_ros",
        executable="segloc_node",
        name="segloc",
        namespace="",
        output="screen",
        respawn=True,
        respawn_delay=2.0,
        parameters=[
            given["params_file"],
            {name: given[name] for name in ("map", "mode", "trigger", "use_sim_time")},
        ],
        remappings=[("points", given["points"]), ("odom", given["odom"])],
    )
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", str(share / "rviz" / "segloc.rviz")],
        condition=IfCondition(given["rviz"]),
    )
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in arguments.items()
    ]
    return LaunchDescription([*declared, node, rviz])
