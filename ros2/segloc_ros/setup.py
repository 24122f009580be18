"""colcon builds it, as it does every ament_python package. segloc itself comes by pip."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "segloc_ros"

setup(
    name=NAME,
    version="0.4.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", [str(path) for path in Path("launch").glob("*.py")]),
        (f"share/{NAME}/config", [str(path) for path in Path("config").glob("*.yaml")]),
        (f"share/{NAME}/rviz", [str(path) for path in Path("rviz").glob("*.rviz")]),
    ],
    install_requires=["setuptools", "segloc"],
    zip_safe=True,
    maintainer="The segloc authors",
    description="Global LiDAR localization in a prior map: a ROS 2 node around segloc.",
    license="MIT",
    url="https://github.com/OWNER/segloc",
    extras_require={"test": ["pytest"]},
    scripts=["scripts/segloc_node"],  # starts faster than the script of an entry point
)
