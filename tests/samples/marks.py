"""Marks of tests by what they need, so that nobody has to remember them."""

from __future__ import annotations

import functools
import inspect
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from .real import real

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
            marks = _marks(item.function) | ({"data"} if "kitti" in item.fixturenames else set())
            for mark in sorted(marks):
                item.add_marker(mark)
    _longest_first(items)


def _longest_first(items: list[pytest.Item]) -> None:
    """Files with many slow tests begin, so that of several processes none waits at the end."""
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])


@functools.cache
def _marks(test: Callable[..., object]) -> set[str]:
    drawn = getattr(test, "hypothesis", None)
    function = drawn.inner_test if drawn else test
    skips = [package for indent, package in _skips(inspect.getfile(function)) if not indent]
    skips += [package for _, package in _SKIPS.findall(inspect.getsource(function))]
    marks = {PACKAGES[package] for package in skips if package in PACKAGES}
    if _calls(function, real):
        marks.add("data")
    return marks | ({"fuzz"} if drawn else set())


@functools.cache
def _skips(path: str) -> list[tuple[str, str]]:
    return _SKIPS.findall(Path(path).read_text("utf-8"))


def _calls(function: Callable[..., object], other: object) -> bool:
    return any(function.__globals__.get(name) is other for name in function.__code__.co_names)
