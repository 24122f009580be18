"""What is replaced inside rosbags, in the versions that were tried."""

from __future__ import annotations

from importlib.metadata import version
from types import SimpleNamespace

import pytest

pytest.importorskip("rosbags")

from segloc.errors import DatasetError
from segloc.tools.datasets.ros import rosbags_reader


def test_this_version_of_rosbags_was_tried() -> None:
    """Another one: run tests/tools/datasets/ros and tests/hostile with it, then add it to TRIED."""
    assert version("rosbags") in rosbags_reader.TRIED


def test_every_replacement_is_in_use() -> None:
    for owner, name, _ in rosbags_reader.replacements():
        value = getattr(owner, name)
        ours = value.values() if isinstance(value, dict) else [value]
        homes = {getattr(each, "__module__", None) or type(each).__module__ for each in ours}
        homes |= {type(each).__module__ for each in ours}
        assert rosbags_reader.__name__ in homes, f"{owner.__name__}.{name} is that of rosbags"


def test_a_version_without_a_replaced_name_is_refused_by_name() -> None:
    other = SimpleNamespace(__name__="rosbags.rosbag3")
    with pytest.raises(DatasetError, match=r"no rosbags\.rosbag3\.parse_qos: pip install"):
        rosbags_reader.install([(other, "parse_qos", str)])
