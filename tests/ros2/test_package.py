"""What goes with the node: its parameters file, its files, and that the core knows no ROS."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path
from unittest.mock import MagicMock

import pytest
import yaml
from samples import source
from samples.source import PROJECT
from segloc_ros.core.settings import Settings

from segloc import ConfigError

ROS2 = PROJECT / "ros2"
STAND_INS = (
    "ament_index_python.packages",
    "launch",
    "launch.actions",
    "launch.conditions",
    "launch.launch_description_sources",
    "launch.substitutions",
    "launch_ros",
    "launch_ros.actions",
)
ALLOWED = {"numpy", "scipy", "pydantic", "segloc", "segloc_ros"}


@pytest.mark.parametrize("package", ["segloc_ros", "segloc_autoware"])
def test_the_core_knows_no_ros(package: str) -> None:
    for path in (ROS2 / package / package / "core").rglob("*.py"):
        names = {name.split(".")[0] for name in source.imported(path, (package, "core"))}
        strange = names - ALLOWED - {package, "__future__"} - set(sys.stdlib_module_names)
        assert not strange, f"{path.name}: {strange}"


def test_the_parameters_file_holds_every_default() -> None:
    file = ROS2 / "segloc_ros" / "config" / "segloc.yaml"
    written = yaml.safe_load(file.read_text("utf-8"))["/**"]["ros__parameters"]
    declared = {name: default for name, default, _ in Settings.declared() if default != []}
    assert written == declared
    text = file.read_text("utf-8")
    assert all(name in text for name, *_ in Settings.declared())
    for other in (ROS2 / "segloc_ros" / "config").glob("*.yaml"):
        values = yaml.safe_load(other.read_text("utf-8"))["/**"]["ros__parameters"]
        Settings.of(values)


def test_packages_have_the_version_of_the_product() -> None:
    project = (PROJECT / "pyproject.toml").read_text("utf-8")
    (version,) = re.findall('^version = "(.*)"', project, re.MULTILINE)
    for file in (*ROS2.glob("*/package.xml"), *ROS2.glob("*/setup.py")):
        found = re.search('<version>(.*)<|version="([0-9].*)",', file.read_text("utf-8"))
        assert version in found.groups(), file


def test_wrong_parameters_are_named() -> None:
    for values in ({"mode": "odom"}, {"tf_rate_hz": 0.0}, {"speed": 1}, {"map_frame": "/"}):
        with pytest.raises(ConfigError, match=next(iter(values))):
            Settings.of(values)
    assert Settings.of({"map_frame": "/map"}).map_frame == "map"


@pytest.mark.parametrize("path", sorted(ROS2.glob("*/launch/*.py")), ids=lambda path: path.name)
def test_launch_files_run(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With stand-ins for launch, of which there is no wheel: at least nothing is misspelt here."""
    for name in STAND_INS:
        monkeypatch.setitem(sys.modules, name, MagicMock())
    sys.modules.pop("segloc_ros.launching", None)
    sys.modules["ament_index_python.packages"].get_package_share_directory.return_value = "/share"
    scope = runpy.run_path(str(path))
    scope["generate_launch_description"]()
    if "node" in scope:
        given = {"use_sim_time": "True", "base_to_lidar": "[0.4, 0, 1.2, 0, 0, 0]"}
        scope["LaunchConfiguration"].side_effect = lambda name: MagicMock(
            perform=MagicMock(return_value=given.get(name, ""))
        )
        assert len(scope["node"](MagicMock())) == 1
        (made,) = sys.modules["launch_ros.actions"].LifecycleNode.call_args_list
        expected = {"use_sim_time": True, "base_to_lidar": [0.4, 0.0, 1.2, 0.0, 0.0, 0.0]}
        assert made.kwargs["parameters"][1] == expected
