"""``segloc view``: what ``localize --debug`` keeps, the scene that it is drawn in, the page."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.walk import POINTS_ASIDE, Site, run, walked_site

from segloc import SegmentMap
from segloc.errors import SeglocError
from segloc.explanation.results import read_results
from segloc.explanation.scene import FIXED, OF_QUERY, MapScene
from segloc.explanation.seen import packed, unpacked

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    return walked_site(tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def results(site: Site, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of two scans that are found and one that is not."""
    scans = tmp_path_factory.mktemp("scans")
    for i, points in enumerate(
        [*(np.load(site.run / f"000{k}.npy") for k in (4, 6)), POINTS_ASIDE]
    ):
        np.save(scans / f"{i}.npy", points)
    out = scans / "results"
    assert run("localize", scans, "--map", site.map, "--out", out, "--debug") == 0
    return out


class Handle:
    def __init__(self, points: Any) -> None:
        self.points, self.visible, self.gone = points, True, False

    def remove(self) -> None:
        self.gone = True


class Api:
    """In place of viser's scene."""

    def __init__(self) -> None:
        self.drawn: dict[str, Handle] = {}

    def _add(self, name: str, what: Any, *_: Any, **__: Any) -> Handle:
        self.drawn[name] = Handle(what)
        return self.drawn[name]

    add_point_cloud = add_line_segments = add_label = _add


@pytest.mark.slow
def test_debug_keeps_each_query_small_and_whole(site: Site, results: Path) -> None:
    shown = read_results(results)
    assert [each.outcome for each in shown] == ["found", "found", "refused"]
    for each in shown:
        assert each.seen is not None
        file = results / "debug" / f"{each.index}.npz"
        assert file.stat().st_size < 200_000
        again = unpacked(packed(each.seen), "again")
        assert packed(again) == packed(each.seen) == file.read_bytes()
        for field in fields(again):
            one, other = (getattr(seen, field.name) for seen in (again, each.seen))
            assert np.array_equal(one, other), field.name
    found = shown[0].seen
    assert found is not None and found.on_map.mean() > 0.8 and found.inliers.sum() > 5
    assert any("segments agree" in line for line in found.lines)


@pytest.mark.slow
def test_a_damaged_file_is_one_line(results: Path, tmp_path: Path) -> None:
    whole = (results / "debug" / "0.npz").read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(60):
        broken = bytearray(whole)
        for at in rng.integers(0, len(broken), 5):
            broken[at] = int(rng.integers(256))
        for data in (bytes(broken), whole[: int(rng.integers(len(whole)))]):
            try:
                unpacked(data, "x.npz")
            except SeglocError as error:
                assert str(error).startswith("x.npz: ") and "\n" not in str(error)
    with pytest.raises(SeglocError, match="no results of `segloc localize --out`"):
        read_results(tmp_path)
    (tmp_path / "localizations.jsonl").write_text('{"index": 1}\n')
    with pytest.raises(SeglocError, match="line 1: damaged"):
        read_results(tmp_path)


@pytest.mark.slow
def test_the_query_lies_on_the_map_in_the_scene(site: Site, results: Path) -> None:
    api, prior_map = Api(), SegmentMap.load(site.map)
    scene, shown = MapScene(api, prior_map), read_results(results)
    scene.draw_map()
    scene.draw_queries(shown)
    assert {"/map/cloud", "/map/path", "/queries/found", "/queries/refused"} <= api.drawn.keys()
    assert len(api.drawn["/queries/found"].points) == 2
    scene.draw_query(shown[0])
    lines = api.drawn["/query/inliers"].points
    assert np.abs(lines[:, 0, :2] - lines[:, 1, :2]).max() < 0.6
    cloud, on_map = api.drawn["/map/cloud"].points, api.drawn["/query/on_map"].points
    nearest = np.linalg.norm(cloud - on_map[0], axis=1).min()
    assert nearest < 0.5
    before = [handle for layer in OF_QUERY for handle in scene.layers[layer]]
    scene.show("segments", False)
    scene.draw_query(shown[1])
    assert all(handle.gone for handle in before)
    assert not any(handle.visible for handle in scene.layers["segments"])
    assert all(handle.visible for layer in FIXED for handle in scene.layers[layer])


@pytest.mark.slow
def test_debug_needs_a_folder(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("localize", site.run, "--map", site.map, "--debug") == 1
    assert "--debug needs --out DIR" in capsys.readouterr().err


def pixels(page: str, picture: Path) -> np.ndarray:
    """A screenshot by Chromium, (H, W, 3), 0 to 1."""
    image = pytest.importorskip("matplotlib.image")
    if CHROMIUM is None:
        pytest.skip("no Chromium here")
    options = ["--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--no-first-run"]
    options += ["--enable-unsafe-swiftshader", "--disable-background-networking"]
    options += ["--window-size=900,700", "--virtual-time-budget=6000", f"--screenshot={picture}"]
    done = subprocess.run(
        [CHROMIUM, *options, f"--user-data-dir={picture.parent / 'profile'}", page],
        capture_output=True,
        timeout=200,
        check=False,
    )
    if not picture.exists():
        pytest.skip(f"Chromium made no picture here: {done.stderr[-200:]!r}")
    return np.asarray(image.imread(picture))[:, :, :3]


def colourful(shot: np.ndarray) -> float:
    """Share of the middle of a screenshot that is neither white nor grey."""
    middle = shot[200:600, 100:800]
    return float((np.ptp(middle, axis=2) > 0.3).mean())


@pytest.mark.slow
def test_the_page_shows_the_map_and_the_queries(site: Site, results: Path, tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="the viewer needs the extra 'view'")
    page = tmp_path / "page.html"
    assert run("view", site.map, results, "--html", page) == 0
    text = page.read_text("utf-8")
    assert len(text) < 20e6 and not re.search(r"<(script|link|img)[^>]+(src|href)=.?http", text)
    shot = pixels(page.as_uri(), tmp_path / "shot.png")
    assert colourful(shot) > 0.01  # segments, matches, markers


@pytest.mark.slow
def test_the_server_shows_a_panel_with_the_reason(
    site: Site, results: Path, tmp_path: Path
) -> None:
    pytest.importorskip("viser", reason="the viewer needs the extra 'view'")
    from segloc.explanation import viewer

    shown = read_results(results)
    server = viewer.serve(SegmentMap.load(site.map), shown, 8199)
    try:
        shot = pixels(f"http://localhost:{server.get_port()}", tmp_path / "shot.png")
    finally:
        server.stop()
    assert colourful(shot) > 0.01
    assert "**2: refused**\n\nnot localized, " in viewer.described(shown[2])
