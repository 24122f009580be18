"""colcon builds it, as it does every ament_python package. segloc itself comes by pip."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "segloc_autoware"

setup(
    name=NAME,
    version="0.4.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", [str(path) for path in Path("launch").glob("*.py")]),
    ],
    install_requires=["setuptools", "segloc", "segloc_ros"],
    zip_safe=True,
    maintainer="The segloc authors",
    description="Global LiDAR localization in a prior map: Autoware's alignment service.",
    license="MIT",
    url="https://github.com/OWNER/segloc",
    extras_require={"test": ["pytest"]},
    scripts=["scripts/align_node"],  # starts faster than the script of an entry point
)
