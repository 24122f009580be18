"""``segloc explain``: the answer of ``localize``, and what it is made of."""

from __future__ import annotations

import re
from html import escape
from pathlib import Path

import numpy as np
import pytest
from samples.walk import POINTS_ASIDE, Site, run, walked_site

from segloc import Localizer, SegmentMap
from segloc.inspect import steps, trace, verdict
from segloc.inspect.page import page
from segloc.inspect.trace import BEYOND
from segloc.likelihood.confidence import FEATURES, shipped_confidence
from segloc.types import Scan


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    return walked_site(tmp_path_factory.mktemp("site"))


@pytest.mark.slow
def test_the_parts_of_the_confidence_add_up_to_it(site: Site) -> None:
    localizer = Localizer(SegmentMap.load(site.map))
    for points in (np.load(site.run / "0004.npy"), POINTS_ASIDE):
        cloud = localizer.accumulator.gather(Scan(points))
        found, plain = trace(localizer, cloud), localizer.localize(cloud)
        assert (found.result.localized, found.result.confidence) == (
            plain.localized,
            plain.confidence,
        )
        if found.parts:
            score = found.constant + sum(part.log_odds for part in found.parts)
            assert 1 / (1 + np.exp(-score)) == pytest.approx(plain.confidence)
            names = [part.name for part in found.parts]
            capped = plain.confidence == pytest.approx(
                1 / (1 + np.exp(-shipped_confidence().max_log_odds))
            )
            assert names == [*FEATURES, *([BEYOND] if capped else [])]
            assert all(" " in part.words for part in found.parts)  # no bare name of a feature
        if plain.localized:
            assert found.T_map_local is not None
            assert np.allclose(found.T_map_local @ found.T_local_sensor, plain.T_map_sensor)
            assert found.inliers.sum() >= plain.inliers and found.on_map.mean() > 0.8
        assert len(np.unique(found.pairs[:, 0])) == len(found.pairs)
        assert verdict(found).startswith("localized" if plain.localized else "not localized")
        assert [name for name, _ in steps(found)][:4] == ["cloud", "ground", "segments", "matches"]


@pytest.mark.slow
def test_explain_prints_a_verdict_and_writes_a_page(
    site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    np.save(tmp_path / "0.npy", POINTS_ASIDE)
    np.save(tmp_path / "1.npy", 1000 * POINTS_ASIDE)
    html = tmp_path / "page.html"
    for scan, said in [
        (site.run / "0004.npy", r"^localized at x "),
        (tmp_path / "0.npy", r"^not localized, "),
        (tmp_path / "1.npy", r"^not localized, no points: .*\nproblem: half of .* in millimetres"),
    ]:
        capsys.readouterr()
        assert run("explain", scan, "--map", site.map, "--html", html) == 0
        out = capsys.readouterr().out
        assert re.search(said, out), out
        text = html.read_text("utf-8")
        assert text.count("data:image/png;base64,") in (2, 5)
        assert not re.search(r"(src|href)=\"(?!data:)", text) and "http" not in text
        assert escape(out.splitlines()[0]) in text


@pytest.mark.slow
def test_a_scan_of_a_recording_is_chosen_by_its_number(
    site: Site, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--map", site.map, "--poses", "poses.tum"]
    assert run("explain", site.run, "--select", 5, *arguments) == 0
    assert re.search(r"cloud +\d+ points of 6 scans", capsys.readouterr().out)
    assert run("explain", site.run, "--select", 99, *arguments) == 1
    assert "has scans 0 to 13" in capsys.readouterr().err


@pytest.mark.slow
def test_the_page_is_the_same_for_the_same_query(site: Site) -> None:
    pytest.importorskip("matplotlib")
    localizer = Localizer(SegmentMap.load(site.map))
    cloud = localizer.accumulator.gather(Scan(np.load(site.run / "0004.npy")))
    pages = [page(trace(localizer, cloud), localizer.prior_map, []) for _ in range(2)]
    assert pages[0] == pages[1]
