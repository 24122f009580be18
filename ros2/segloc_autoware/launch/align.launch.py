"""segloc as Autoware's initial pose estimator, in place of the NDT scan matcher's service.

ros2 launch segloc_autoware align.launch.py map:=/maps/site.segmap points:=/sensing/lidar/...

With ``odometry:=topic odom:=/localization/kinematic_state`` the vehicle may drive meanwhile.
"""

from launch import LaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.parameter_descriptions import ParameterValue
from segloc_ros.launching import declared, localizer


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
    node = localizer(
        "segloc_autoware",
        "align_node",
        parameters=[
            {
                "map": ParameterValue(given["map"], value_type=str),
                "use_sim_time": given["use_sim_time"],
                "mode": "initialpose",
                "trigger": "service",
                "odometry": given["odometry"],
                "initialpose_topic": "~/initialpose",
                "click_topic": "~/click",
                "service_timeout_s": 10.0,
            }
        ],
        remappings=[
            ("points", given["points"]),
            ("odom", given["odom"]),
            ("ndt_align_srv", given["service"]),
        ],
    )
    return LaunchDescription([*declared(arguments), node])
