"""Parts that the launch files share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    GroupAction,
    IncludeLaunchDescription,
)
from launch.events import matches_action
from launch.events.process import ProcessExited, ShutdownProcess
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import LifecycleNode

from .process import EXIT_CONFIG, LAUNCHED


def share(package: str) -> Path:
    """Folder of a package's installed files."""
    return Path(get_package_share_directory(package))


def segloc(**fixed: str) -> GroupAction:
    """Include segloc.launch.py with fixed arguments; all others are the command line's."""
    return _included("segloc_ros", "segloc.launch.py", fixed)


def localizer(package: str, executable: str, **options: Any) -> LifecycleNode:
    """Start a node of segloc; again if it crashes, but not if it refused its parameters."""
    return LifecycleNode(
        package=package,
        executable=executable,
        name="segloc",
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        additional_env={LAUNCHED: "1"},
        respawn=True,
        respawn_delay=2.0,
        on_exit=_keep_ended,
        **options,
    )


def declared(arguments: dict[str, tuple[str, str]]) -> list[DeclareLaunchArgument]:
    """Declare launch arguments, given as defaults and descriptions by name."""
    return [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in arguments.items()
    ]


def nav2(**arguments: Any) -> GroupAction:
    """Include Nav2's bringup with the arguments of :func:`nav2_arguments`, and more."""
    namespace = LaunchConfiguration("namespace")
    shared = {
        "map": LaunchConfiguration("grid"),
        "params_file": LaunchConfiguration("nav2_params_file"),
        "namespace": namespace,
        "use_namespace": PythonExpression(["'", namespace, "' != ''"]),  # Jazzy
        "use_sim_time": LaunchConfiguration("use_sim_time"),
    }
    return _included("nav2_bringup", "bringup_launch.py", shared | arguments)


def nav2_arguments() -> list[DeclareLaunchArgument]:
    """Arguments of the launch files that start Nav2."""
    parameters = share("nav2_bringup") / "params" / "nav2_params.yaml"
    return [
        DeclareLaunchArgument("grid", description="Nav2's map.yaml, in the frame of the map"),
        DeclareLaunchArgument("nav2_params_file", default_value=str(parameters)),
        DeclareLaunchArgument("namespace", default_value=""),
        DeclareLaunchArgument("use_sim_time", default_value="false"),
    ]


def _keep_ended(event: ProcessExited, context: LaunchContext) -> EmitEvent | None:
    """Prevent that a node is started again that ended by itself."""
    if event.returncode not in (0, EXIT_CONFIG):
        return None
    return EmitEvent(event=ShutdownProcess(process_matcher=matches_action(event.action)))


def _included(package: str, file: str, arguments: dict[str, Any]) -> GroupAction:
    """Include a launch file in a scope of its own: Nav2 and segloc both have a ``map``."""
    source = PythonLaunchDescriptionSource(str(share(package) / "launch" / file))
    return GroupAction([IncludeLaunchDescription(source, launch_arguments=arguments.items())])
