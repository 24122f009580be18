"""segloc and Nav2 with AMCL: segloc finds the robot, AMCL follows it from there.

ros2 launch segloc_ros nav2.launch.py map:=/maps/site.segmap grid:=/maps/site.yaml
    points:=/points odom:=/odom [namespace:=robot1] [nav2_params_file:=...]

Further arguments are those of segloc.launch.py.
"""

from launch import LaunchDescription
from launch.substitutions import LaunchConfiguration, PythonExpression
from segloc_ros.launching import nav2, nav2_arguments, segloc, share


def generate_launch_description() -> LaunchDescription:
    bringup = nav2(
        "bringup_launch.py",
        map=LaunchConfiguration("grid"),
        use_namespace=PythonExpression(["'", LaunchConfiguration("namespace"), "' != ''"]),
    )
    node = segloc(params_file=str(share("segloc_ros") / "config" / "nav2.yaml"))
    return LaunchDescription([*nav2_arguments(), node, bringup])
