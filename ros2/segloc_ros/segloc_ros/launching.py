"""Parts that the launch files share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration


def share(package: str) -> Path:
    """Folder of a package's installed files."""
    return Path(get_package_share_directory(package))


def segloc(**fixed: str) -> GroupAction:
    """Include segloc.launch.py with fixed arguments; all others are the command line's."""
    return _included("segloc_ros", "segloc.launch.py", fixed)


def nav2(file: str, **arguments: Any) -> GroupAction:
    """Include a launch file of Nav2 with the arguments of :func:`nav2_arguments`, and more."""
    shared = {
        "params_file": LaunchConfiguration("nav2_params_file"),
        "namespace": LaunchConfiguration("namespace"),
        "use_sim_time": LaunchConfiguration("use_sim_time"),
    }
    return _included("nav2_bringup", file, shared | arguments)


def nav2_arguments() -> list[DeclareLaunchArgument]:
    """Arguments of the launch files that start Nav2."""
    parameters = share("nav2_bringup") / "params" / "nav2_params.yaml"
    return [
        DeclareLaunchArgument("grid", description="Nav2's map.yaml, in the frame of the map"),
        DeclareLaunchArgument("nav2_params_file", default_value=str(parameters)),
        DeclareLaunchArgument("namespace", default_value=""),
        DeclareLaunchArgument("use_sim_time", default_value="false"),
    ]


def _included(package: str, file: str, arguments: dict[str, Any]) -> GroupAction:
    """Include a launch file in a scope of its own: Nav2 and segloc both have a ``map``."""
    source = PythonLaunchDescriptionSource(str(share(package) / "launch" / file))
    return GroupAction([IncludeLaunchDescription(source, launch_arguments=arguments.items())])
