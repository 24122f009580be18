"""Shared by the tests: real scans where they are at hand, and a small scene that needs nothing."""

from __future__ import annotations

import functools
import inspect
import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings
from samples.plaza import Plaza
from samples.real import real

# No deadlines: how long an example takes says more of the machine than of the code.
settings.register_profile("usual", deadline=None)
settings.register_profile("sanitized", deadline=None, max_examples=20)  # several times slower
settings.load_profile("sanitized" if "SEGLOC_NATIVE" in os.environ else "usual")

PACKAGES = {"torch": "torch", "rosbags": "ros"}
"""Marks by what a test, or its module at the top, skips without."""
_SKIPS = re.compile(r'^( *)(?:\w+ = )?pytest\.importorskip\("(\w+)', re.M)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out modules that import torch where its tests are not wanted: importing takes long."""
    if "not torch" not in config.option.markexpr or collection_path.suffix != ".py":
        return None
    return ("", "torch") in _skips(str(collection_path)) or None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests by what they need; ``slow`` alone is written at the tests themselves."""
    for item in items:
        if isinstance(item, pytest.Function):
            for mark in sorted(_marks(item)):
                item.add_marker(mark)


def _marks(item: pytest.Function) -> set[str]:
    drawn = getattr(item.function, "hypothesis", None)
    function = drawn.inner_test if drawn else item.function
    skips = [package for indent, package in _skips(inspect.getfile(function)) if not indent]
    skips += [package for _, package in _SKIPS.findall(inspect.getsource(function))]
    marks = {PACKAGES[package] for package in skips if package in PACKAGES}
    if "kitti" in item.fixturenames or _calls(function, real):
        marks.add("data")
    return marks | ({"fuzz"} if drawn else set())


@functools.cache
def _skips(path: str) -> list[tuple[str, str]]:
    return _SKIPS.findall(Path(path).read_text("utf-8"))


def _calls(function: Callable[..., object], other: object) -> bool:
    return any(function.__globals__.get(name) is other for name in function.__code__.co_names)


@pytest.fixture(scope="session")
def kitti() -> Path:
    """The folder with KITTI 00 as LAZ scans and TUM poses."""
    pytest.importorskip("laspy")
    return real("kitti00")


@pytest.fixture(scope="session")
def plaza() -> Plaza:
    return Plaza(0)
