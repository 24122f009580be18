"""What goes with the node: its parameters file, its files, and that the core knows no ROS."""

from __future__ import annotations

import importlib
import re
import sys

import pytest
import yaml
from samples import source
from samples.source import PROJECT
from segloc_ros.core.diagnosis import StateStatus, TfState
from segloc_ros.core.settings import Settings

from segloc import ConfigError

ROS2 = PROJECT / "ros2"
ALLOWED = {"numpy", "scipy", "pydantic", "segloc", "segloc_ros"}


@pytest.mark.parametrize("package", ["segloc_ros", "segloc_autoware"])
def test_the_core_knows_no_ros(package: str) -> None:
    paths = list((ROS2 / package / package).glob("core*/**/*.py"))
    paths += (ROS2 / package / package).glob("core.py")
    assert paths
    for path in paths:
        names = {name.split(".")[0] for name in source.imported(path, (package, "core"))}
        strange = names - ALLOWED - {package, "__future__"} - set(sys.stdlib_module_names)
        assert not strange, f"{path.name}: {strange}"


@pytest.mark.parametrize("package", ["segloc_ros", "segloc_autoware"])
def test_only_promised_names_of_segloc_are_imported(package: str) -> None:
    """Those of the modules that docs/reference/guarantees.md lists, in their ``__all__``."""
    page = (PROJECT / "docs" / "reference" / "guarantees.md").read_text("utf-8")
    (row,) = re.findall(r"^\| names in `__all__` of (.+?) \|", page, re.MULTILINE)
    modules = re.findall(r"`(segloc[\w.]*)`", row)
    promised = {f"{m}.{name}" for m in modules for name in importlib.import_module(m).__all__}
    used = set()
    for path in (ROS2 / package).rglob("*.py"):
        names = source.imported(path, (package, "core"))
        used |= {name for name in names if name.split(".")[0] == "segloc"}
    assert used - {*promised, *modules} == set()
    assert "segloc.robot.Section" in used or package != "segloc_ros"


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


def test_the_message_of_the_state_has_the_constants_of_the_core() -> None:
    text = (ROS2 / "segloc_msgs" / "msg" / "State.msg").read_text("utf-8")
    constants = {name: int(value) for name, value in re.findall(r"^uint8 (\w+)=(\d)", text, re.M)}
    expected = {status.name: status.value for status in StateStatus}
    assert constants == expected | {f"TF_{each.name}": each.value for each in TfState}


def test_wrong_parameters_are_named() -> None:
    for values in ({"mode": "odom"}, {"tf_rate_hz": 0.0}, {"speed": 1}, {"map_frame": "/"}):
        with pytest.raises(ConfigError, match=next(iter(values))):
            Settings.of(values)
    assert Settings.of({"map_frame": "/map"}).map_frame == "map"


@pytest.mark.parametrize("package", ["segloc_ros", "segloc_autoware"])
def test_the_manifest_names_what_is_imported_and_started(package: str) -> None:
    folder = ROS2 / package
    depends = set(re.findall("_depend>(.+)</", (folder / "package.xml").read_text("utf-8")))
    files = [*folder.glob("launch/*.py"), *(folder / package).rglob("*.py")]
    texts = [path.read_text("utf-8") for path in files]
    imports = r"^ *(?:from|import) (\w+)"
    used = {name for text in texts for name in re.findall(imports, text, re.MULTILINE)}
    started = r"(?:package=|share\(|_included\(|localizer\(\s*)\"(\w+)\""
    used |= {name for text in texts for name in re.findall(started, text)}
    keys = {name: f"python3-{name}" for name in ("numpy", "scipy", "yaml")}
    ours = {package, "segloc", "pydantic", *sys.stdlib_module_names}  # pip brings pydantic
    assert {keys.get(name, name) for name in used - ours} <= depends
