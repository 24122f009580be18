"""segloc as Autoware's initial pose estimator, in place of the NDT scan matcher's service.

ros2 launch segloc_autoware align.launch.py map:=/maps/site.segmap points:=/sensing/lidar/...

With ``odometry:=topic odom:=/localization/kinematic_state`` the vehicle may drive meanwhile.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode


def generate_launch_description() -> LaunchDescription:
    arguments = {
        "map": ("", "the .segmap, in Autoware's map frame"),
        "points": ("/sensing/lidar/concatenated/pointcloud", "clouds"),
        "odom": ("odom", "odometry, with odometry:=topic"),
        "odometry": ("none", "none: the vehicle stands, and the EKF has not begun; or topic"),
        "namespace": ("", "namespace of the node"),
        "service": ("/localization/pose_estimator/ndt_align_srv", "what pose_initializer asks"),
        "use_sim_time": ("false", "for a bag or a simulator"),
    }
    given = {name: LaunchConfiguration(name) for name in arguments}
    node = LifecycleNode(
        package="segloc_autoware",
        executable="align_node",
        name="segloc",
        namespace=given["namespace"],
        output="screen",
        respawn=True,
        parameters=[
            {
                "map": given["map"],
                "use_sim_time": given["use_sim_time"],
                "mode": "initialpose",
                "trigger": "service",
                "odometry": given["odometry"],
                "initialpose_topic": "~/initialpose",
                "service_timeout_s": 10.0,
            }
        ],
        remappings=[
            ("points", given["points"]),
            ("odom", given["odom"]),
            ("ndt_align_srv", given["service"]),
        ],
    )
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in arguments.items()
    ]
    return LaunchDescription([*declared, node])
