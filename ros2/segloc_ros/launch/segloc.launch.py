"""ros2 launch segloc_ros segloc.launch.py map:=/maps/site.segmap [params_file:=...] [rviz:=true]

What is not given here is as the file of parameters says.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node

SHARE = Path(get_package_share_directory("segloc_ros"))
PARAMETERS = {
    "map": "the .segmap",
    "mode": "initialpose, tf or both",
    "trigger": "until_localized, periodic or service",
    "use_sim_time": "true for a bag or a simulator",
}
ARGUMENTS = {
    "params_file": (str(SHARE / "config" / "segloc.yaml"), "parameters"),
    "namespace": ("", "of the node"),
    "points": ("points", "the topic of the clouds"),
    "odom": ("odom", "the topic of the odometry"),
    "rviz": ("false", "whether to show it"),
}


def node(context: LaunchContext) -> list[LifecycleNode]:
    """The node, with the parameters that were given."""
    values = {name: LaunchConfiguration(name).perform(context) for name in PARAMETERS}
    given = {name: value for name, value in values.items() if value}
    if "use_sim_time" in given:
        given["use_sim_time"] = given["use_sim_time"].lower() == "true"
    return [
        LifecycleNode(
            package="segloc_ros",
            executable="segloc_node",
            name="segloc",
            namespace=LaunchConfiguration("namespace"),
            output="screen",
            respawn=True,
            respawn_delay=2.0,
            parameters=[LaunchConfiguration("params_file"), given],
            remappings=[
                ("points", LaunchConfiguration("points")),
                ("odom", LaunchConfiguration("odom")),
            ],
        )
    ]


def generate_launch_description() -> LaunchDescription:
    arguments = {name: ("", text) for name, text in PARAMETERS.items()} | ARGUMENTS
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", str(SHARE / "rviz" / "segloc.rviz")],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=node), rviz])
