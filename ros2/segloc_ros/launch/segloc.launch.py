"""The node alone; the other launch files include this one and take its arguments.

ros2 launch segloc_ros segloc.launch.py map:=/maps/site.segmap points:=/points odom:=/odom

Arguments that are not given are as the file of parameters says.
"""

from pathlib import Path

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from segloc_ros.launching import declared, localizer, share

SHARE = share("segloc_ros")
PARAMETERS = {
    "map": "the .segmap, or a folder or URL of tiles",
    "mode": "initialpose, tf or both",
    "tf_when_lost": "map -> odom of a lost robot: drop or keep",
    "trigger": "until_localized, periodic or service",
    "odometry": "topic, tf, kiss-icp or none",
    "base_to_lidar": "mount where tf has none: '[x, y, z, roll, pitch, yaw]'",
    "height_topic": "topic of the base's height in the map, as of a barometer or a lift",
    "pose_file": "file that keeps the pose over a power cycle",
    "smooth_tf": "true: map -> odom without jumps",
    "use_sim_time": "true for a bag or a simulator",
}
FLAGS = ("smooth_tf", "use_sim_time")
ARGUMENTS = {name: ("", text) for name, text in PARAMETERS.items()} | {
    "params_file": ("", "file of parameters, which may hold only those that differ"),
    "default_params_file": (str(SHARE / "config" / "segloc.yaml"), "file of the others"),
    "namespace": ("", "namespace of the node, its topics and tf"),
    "points": ("points", "topic of the clouds"),
    "odom": ("odom", "topic of the odometry"),
    "amcl_names": ("false", "true: pose and services under AMCL's names, such as amcl_pose"),
    "rviz": ("false", "true: show the map, the clouds and the pose"),
}
AMCL_NAMES = {
    "pose": "amcl_pose",
    "reinitialize_global_localization": "reinitialize_global_localization",
    "request_nomotion_update": "request_nomotion_update",
    "set_initial_pose": "set_initial_pose",
}
TF = [("/tf", "tf"), ("/tf_static", "tf_static")]  # in a namespace each robot has its own


def mount(text: str) -> list[float]:
    """The numbers of base_to_lidar; ROS takes no list of integers and floats."""
    try:
        return [float(number) for number in yaml.safe_load(text)]
    except (TypeError, ValueError, yaml.YAMLError):
        raise RuntimeError(
            f"base_to_lidar:={text} is no list '[x, y, z, roll, pitch, yaw]' in metres and radians"
        ) from None


def nodes(context: LaunchContext) -> list[Node]:
    """The node with the parameters that were given, and RViz."""
    values = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    given = {name: values[name] for name in PARAMETERS if values[name]}
    given |= {name: yaml.safe_load(given[name]) for name in FLAGS if name in given}
    if "base_to_lidar" in given:
        given["base_to_lidar"] = mount(given["base_to_lidar"])
    files = [Path(values[name]) for name in ("default_params_file", "params_file") if values[name]]
    for file in files:
        if not file.is_file():
            raise RuntimeError(f"no file of parameters {file}: check params_file")
    renamed = AMCL_NAMES if yaml.safe_load(values["amcl_names"]) is True else {}
    remappings = [("points", values["points"]), *TF]
    localizing = localizer(
        "segloc_ros",
        "segloc_node",
        parameters=[*files, given],
        remappings=[
            *remappings,
            ("odom", values["odom"]),
            *((f"~/{name}", amcls) for name, amcls in renamed.items()),
        ],
    )
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=values["namespace"],
        arguments=["-d", str(SHARE / "rviz" / "segloc.rviz")],
        parameters=[{"use_sim_time": given.get("use_sim_time", False)}],
        remappings=[*remappings, *((f"segloc/{name}", amcls) for name, amcls in renamed.items())],
        condition=IfCondition(values["rviz"]),
    )
    return [localizing, rviz]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*declared(ARGUMENTS), OpaqueFunction(function=nodes)])
