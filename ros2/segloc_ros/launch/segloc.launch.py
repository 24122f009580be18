"""The node alone; the other launch files include this one and take its arguments.

ros2 launch segloc_ros segloc.launch.py map:=/maps/site.segmap points:=/points odom:=/odom

Arguments that are not given are as the file of parameters says.
"""

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from segloc_ros.launching import share

SHARE = share("segloc_ros")
PARAMETERS = {
    "map": "the .segmap, or a folder or URL of tiles",
    "mode": "initialpose, tf or both",
    "trigger": "until_localized, periodic or service",
    "odometry": "topic, tf, kiss-icp or none",
    "base_to_lidar": "mount where tf has none: '[x, y, z, roll, pitch, yaw]'",
    "pose_file": "file that keeps the pose over a power cycle",
    "smooth_tf": "true: map -> odom without jumps",
    "use_sim_time": "true for a bag or a simulator",
}
VALUES = ("base_to_lidar", "smooth_tf", "use_sim_time")
ARGUMENTS = {
    "params_file": (str(SHARE / "config" / "segloc.yaml"), "parameters"),
    "namespace": ("", "namespace of the node, its topics and tf"),
    "points": ("points", "topic of the clouds"),
    "odom": ("odom", "topic of the odometry"),
    "rviz": ("false", "true: show the map, the clouds and the pose"),
}


def node(context: LaunchContext) -> list[LifecycleNode]:
    """The node, with the parameters that were given."""
    values = {name: LaunchConfiguration(name).perform(context) for name in PARAMETERS}
    given = {name: value for name, value in values.items() if value}
    given |= {name: yaml.safe_load(given[name]) for name in VALUES if name in given}
    if "base_to_lidar" in given:  # ROS takes no list of integers and floats
        given["base_to_lidar"] = [float(number) for number in given["base_to_lidar"]]
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
                ("/tf", "tf"),  # in a namespace each robot has its own
                ("/tf_static", "tf_static"),
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
