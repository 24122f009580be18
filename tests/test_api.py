"""The package as one meets it in a Python prompt: its index, its answers, their messages."""

from __future__ import annotations

import importlib
import re
import sys
from typing import Any

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence

import segloc
from segloc import Config, Localizer, MissingDependency, NotLocalized, SegmentMap, build_map
from segloc.tools.doctor import hint

CONFIG = Config(threads=1)


@pytest.fixture(scope="module")
def prior_map(plaza: Plaza) -> SegmentMap:
    return build_map(PlazaSequence(plaza, 8), CONFIG)


@pytest.fixture(scope="module")
def localizer(prior_map: SegmentMap) -> Localizer:
    return Localizer(prior_map, CONFIG)


@pytest.fixture(scope="module")
def points(plaza: Plaza) -> Any:
    return PlazaSequence(plaza, 8).scan(4).points


def test_the_docstring_is_an_index_of_the_public_names() -> None:
    assert segloc.__doc__ is not None
    missing = [
        name
        for name in segloc.__all__
        if not name.startswith("_") and not re.search(rf"\b{name}\b", segloc.__doc__)
    ]
    assert not missing
    listed = re.findall(r"^    (\w+) {2,}\S", segloc.__doc__, re.MULTILINE)
    assert listed and set(listed) <= set(segloc.__all__)


def test_an_answer_is_a_line(localizer: Localizer, points: Any) -> None:
    result = localizer.localize(points)
    assert result.localized
    x, y, z = result.T_map_sensor[:3, 3]
    pose = f"x {x:.2f}, y {y:.2f}, z {z:.2f} m, yaw 22.9 deg"
    assert str(result).startswith(f"localized at {pose} (confidence ")
    assert repr(result).startswith("Localized(x=") and len(repr(result)) < 150
    none = localizer.localize(1000 * points)
    assert isinstance(none, NotLocalized)
    assert str(none) == f"not localized: {none.message}"


def test_answers_and_maps_are_drawn(
    localizer: Localizer, prior_map: SegmentMap, points: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    result = localizer.localize(points)
    axes = result.plot(prior_map)
    assert axes.get_title("left") == str(result)
    assert prior_map.plot(axes) is axes
    low, high = axes.get_xlim()
    assert low < prior_map.centroids[:, 0].min() < prior_map.centroids[:, 0].max() < high
    pyplot.close("all")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingDependency, match=r"\(extra report\): pip install 'matplotlib"):
        prior_map.plot()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            lambda p: 1000 * p,
            r"none of \d+ points lies within 50 m of the sensor; half are beyond ",
        ),
        (lambda p: 1000 * p, "are they in millimetres"),
        (lambda p: np.vstack([1000 * p, np.zeros((9, 3))]), r"9 of \d+ points lie within"),
        (lambda p: p + [5e3, 0, 0], r"one side, \d+ m off: are they in world coordinates"),
        (lambda p: np.nan * p, r"all \d+ points are NaN or infinite"),
        (lambda p: p[:0], "the scan is empty"),
    ],
)
def test_scans_of_which_nothing_is_left_say_why(
    localizer: Localizer, points: Any, change: Any, expected: str
) -> None:
    result = localizer.localize(change(points))
    assert re.search(expected, result.message), result.message


def test_a_map_of_nothing_and_a_prior_beside_the_map_are_told(
    localizer: Localizer, prior_map: SegmentMap, points: Any
) -> None:
    far = localizer.localize(points, near=((4000.0, 0.0), 10.0))
    assert re.search(r"the map is 39\d\d m from there and spans x -", far.message), far.message
    nothing = prior_map.crop((4000.0, 0.0), 50.0)
    empty = Localizer(nothing, CONFIG).localize(points)
    assert empty.message == "no matches (the map has no segments, and 0 points)"


def test_why_queries_fail_is_found_from_scans_in_memory(localizer: Localizer, points: Any) -> None:
    camera = points[:, [1, 2, 0]] * [-1, -1, 1]
    output = hint([camera], [localizer.localize(camera)])
    assert output is not None and "a camera's (x right, y down, z forward)" in output


def test_moved_modules_have_their_old_names_for_a_version() -> None:
    with pytest.warns(DeprecationWarning, match=r"^segloc\.io(\.ply|) is segloc\.tools\.io\1;"):
        found = importlib.import_module("segloc.io.ply")
    assert found is importlib.import_module("segloc.tools.io.ply")
    with pytest.raises(ModuleNotFoundError, match=r"segloc\.tools\.io\.none"):
        importlib.import_module("segloc.io.none")
