"""The pictures of the documents are what their commands draw."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.source import PROJECT, loaded
from samples.walk import run

from segloc import SegmentMap

IMAGES = PROJECT / "docs" / "images"


@pytest.mark.slow
def test_the_hero_is_what_its_command_draws(tmp_path: Path) -> None:
    """Scan, pose and matches."""
    pytest.importorskip("matplotlib", reason="pictures need the extra 'report'")
    image = pytest.importorskip("PIL.Image")
    hero = loaded(IMAGES / "hero.py")
    prior_map, found = hero.answered(hero.QUERY)
    drawn = image.open(io.BytesIO(hero.picture(prior_map, found))).convert("RGB")
    with image.open(IMAGES / "hero.png") as kept:
        alike(kept, drawn)
    assert found.inliers.sum() > 20 and found.result.confidence > 0.99


@pytest.mark.slow
def test_the_demo_tells_right_from_elsewhere_and_its_pictures_are_the_kept_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The counts in the legend but for one or two, the rest to the eye."""
    pytest.importorskip("matplotlib", reason="pictures need the extra 'report'")
    image = pytest.importorskip("PIL.Image")
    out, demo = tmp_path / "demo", loaded(IMAGES / "demo.py")
    assert run("demo", "--out", out) == 0
    assert "refused" in capsys.readouterr().out
    again, other = (
        json.loads((out / name / "summary.json").read_text()) for name in ("revisit", "elsewhere")
    )
    assert again["within_coverage"] >= 40 and other["queries"] >= 20
    assert again["within_coverage_correct"] > 0.9 * again["within_coverage"]
    assert again["false"] == other["localized"] == other["within_coverage"] == 0
    assert len(SegmentMap.load(out / "town.segmap")) > 0
    demo.keep(out / "revisit", tmp_path)
    for name in demo.KEPT.values():
        with image.open(tmp_path / name) as drawn, image.open(IMAGES / name) as kept:
            assert_nearly_same(drawn.info.get(demo.KEY, ""), kept.info.get(demo.KEY, ""))
            alike(kept, drawn)
    with image.open(tmp_path / "demo.png") as drawn:
        assert f"localized ({again['correct']})" in drawn.info[demo.KEY]


def assert_nearly_same(output: str, kept: str) -> None:
    """Processors round rays otherwise: a query at the threshold is told otherwise, too."""
    assert re.sub(r"\d+", "", output) == re.sub(r"\d+", "", kept)
    counts = [np.array(re.findall(r"\((\d+)\)", text), dtype=int) for text in (output, kept)]
    assert np.abs(np.subtract(*counts)).max(initial=0) <= 2


def alike(kept: Any, drawn: Any) -> None:
    """To the eye: fonts and the rounding of colours may differ."""
    assert kept.size == drawn.size
    small = [each.convert("L").resize((110, 70)) for each in (kept, drawn)]
    one, other = (np.asarray(each, dtype=float) for each in small)
    assert np.abs(one - other).mean() < 3.0
    assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.97
