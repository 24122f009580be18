"""``segloc view``: what ``localize --debug`` keeps, the scene that it is drawn in, the page."""

from __future__ import annotations

import io
import operator
import re
import socket
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from samples import browser
from samples.walk import POINTS_ASIDE, Site, run
from scipy.spatial import cKDTree

from segloc import SegmentMap, geometry
from segloc.errors import SeglocError
from segloc.tools.datasets import open_sequence
from segloc.tools.inspect import pictures, viewer
from segloc.tools.inspect.following import (
    SO_FAR,
    Moment,
    draw_moments,
    follows,
    newest_points,
    read_moments,
)
from segloc.tools.inspect.pictures import GREEN, PATH, rgb
from segloc.tools.inspect.results import pack, read_results, unpack
from segloc.tools.inspect.scene import FIXED, OF_QUERY, OTHER, RUNNER_UP, MapScene
from segloc.tracking.belief import Status


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
        self.colours: dict[str, Any] = {}

    def _add(self, name: str, what: Any, colours: Any = None, **_: Any) -> Handle:
        self.drawn[name], self.colours[name] = Handle(what), colours
        return self.drawn[name]

    add_point_cloud = add_line_segments = add_arrows = add_label = _add


def test_viewpoints_of_a_finished_cloud_are_points_and_no_trajectory() -> None:
    axes_of = pytest.importorskip("matplotlib.figure").Figure
    prior_map = SegmentMap.empty("geo", "f", 2, (5.0, 5.0, 0.0))
    places = np.stack([geometry.yaw_transform(0.0, (4.0 * k, 0.0, 1.0)) for k in range(4)])
    prior_map.add_trajectory(places)
    for source, shown, words in (
        ("", "/map/trajectory", "mapped trajectory"),
        ("cloud", "/map/viewpoints", "viewpoints of the map"),
    ):
        prior_map.metadata["source"] = source
        api = Api()
        assert [name for _, name in MapScene(api, prior_map).draw_map()] == [words]
        assert list(api.drawn) == [shown]
        axes = prior_map.plot(axes_of().add_subplot())
        (label,) = axes.get_legend_handles_labels()[1]
        assert label == words.replace("mapped trajectory", "trajectory of the map")


def test_names_of_folders_are_no_formulas() -> None:
    figure = pytest.importorskip("matplotlib.figure").Figure()
    axes = figure.add_subplot()
    axes.plot([0, 1], label="$SITE_$DATE")
    pictures.title(figure, "$SITE_$DATE")
    pictures.legend(axes)
    figure.savefig(io.BytesIO())


def test_results_that_are_no_text_are_named(tmp_path: Path) -> None:
    for name, read in (("localizations.jsonl", read_results), ("states.jsonl", read_moments)):
        (tmp_path / name).write_bytes(b"\xff\xfe\n")
        with pytest.raises(SeglocError, match=re.escape(str(tmp_path))):
            read(tmp_path)


@pytest.mark.slow
def test_debug_keeps_each_query_small_and_whole(site: Site, results: Path) -> None:
    shown = read_results(results)
    assert [each.outcome for each in shown] == ["localized", "localized", "refused"]
    for each in shown:
        assert each.stages is not None
        file = results / "debug" / f"{each.index}.npz"
        assert file.stat().st_size < 200_000
        again = unpack(pack(each.stages), "again")
        assert pack(again) == pack(each.stages) == file.read_bytes()
        for field in fields(again):
            one, other = (getattr(seen, field.name) for seen in (again, each.stages))
            equal = np.array_equal if isinstance(one, np.ndarray) else operator.eq
            assert equal(one, other), field.name
    found = shown[0].stages
    assert found is not None and found.on_map.mean() > 0.8 and found.inliers.sum() > 5
    for each, words in zip(shown, ("decides without segments",) * 2 + ("agree",), strict=True):
        assert each.stages is not None
        tables = [text for _, rows in each.stages.tables for *_, text in rows]
        assert any(words in text for text in tables)


@pytest.mark.slow
def test_results_are_of_the_last_run_alone(site: Site, tmp_path: Path) -> None:
    given, out = ("localize", site.run, "--map", site.map, "--select"), tmp_path / "out"
    more = ("--poses", "poses.tum", "--truth", "poses.tum", "--debug", "--out", out)
    assert run(*given, "4:5", *more) == 0
    assert (out / "errors.png").exists() and all(each.stages for each in read_results(out))
    (out / "notes.txt").write_text("mine")
    assert run(*given, "4", "--out", out) == 0
    (shown,) = read_results(out)
    assert shown.stages is None and not (out / "errors.png").exists()
    assert (out / "notes.txt").exists()


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
                unpack(data, "x.npz")
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
    assert {
        "/map/cloud",
        "/map/trajectory",
        "/queries/localized",
        "/queries/refused",
    } <= api.drawn.keys()
    assert len(api.drawn["/queries/localized"].points) == 2
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
def test_the_first_picture_is_the_query_on_its_map(site: Site, results: Path) -> None:
    prior_map, shown = SegmentMap.load(site.map), read_results(results)
    api = Api()
    scene = MapScene(api, prior_map)
    scene.draw_map()
    scene.draw_queries(shown)
    scene.in_view(scene.middle(shown[0]))
    scene.draw_query(shown[0])
    seen = {name for name, handles in scene.layers.items() if any(h.visible for h in handles)}
    assert seen == {*FIXED, *OF_QUERY} - {OTHER, RUNNER_UP}
    start, tip = api.drawn["/query/sensor"].points[0]
    T = shown[0].T_map_sensor
    assert T is not None and np.allclose((tip - start) / np.linalg.norm(tip - start), T[:3, 0])
    assert np.allclose(start[:2], (T[:3, 3] - prior_map.origin)[:2], atol=1e-3)
    ((left, right),) = api.drawn["/scale/bar"].points
    assert api.drawn["/scale/length"].points == f"{np.linalg.norm(right - left):.0f} m"


@pytest.mark.slow
def test_the_slider_rests_on_numbers_of_queries(site: Site, results: Path) -> None:
    numbered = zip(read_results(results), (3, 7, 40), strict=True)
    shown = [replace(each, index=k) for each, k in numbered]
    stages = shown[2].stages
    assert stages is not None and stages.T_map_local is not None
    beside = stages.T_map_local @ geometry.yaw_transform(0.5, (9.0, 0.0, 0.0))
    shown[2] = replace(shown[2], stages=replace(stages, T_map_other=beside))
    scene, server = MapScene(Api(), SegmentMap.load(site.map)), MagicMock()
    slider, texts = server.gui.add_slider(), [MagicMock(), MagicMock()]
    slider.value, server.gui.add_markdown.side_effect = 3, texts
    viewer._add_choice(server, scene, shown)
    change = slider.on_update.call_args.args[0]
    for moved, rests in ((4, 7), (5, 3), (30, 40), (40, 40)):
        slider.value = moved
        change(None)
        assert slider.value == rests and texts[0].content.startswith(f"**{rests}: ")
    group = server.gui.add_button_group()
    click = group.on_click.call_args.args[0]
    for pressed, visible in ((RUNNER_UP, True), ("pose", False)):
        group.value = pressed
        click(None)
        handles = scene.layers[RUNNER_UP]
        assert handles and all(handle.visible == visible for handle in handles)


@pytest.mark.slow
def test_debug_needs_a_folder(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("localize", site.run, "--map", site.map, "--debug") == 1
    assert "--debug needs --out DIR" in capsys.readouterr().err


@pytest.fixture(scope="module")
def browser_page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A page of a headless browser."""
    pytest.importorskip("viser", reason="the viewer needs the extra 'view'")
    pytest.importorskip("websockets", reason="the browser is driven through a socket")
    pytest.importorskip("matplotlib.image")
    if browser.CHROMIUM is None:
        pytest.skip("no Chromium here")
    try:
        with browser.browser(tmp_path_factory.mktemp("profile")) as page:
            yield page
    except RuntimeError as error:
        pytest.skip(f"Chromium does not work here: {error}")


def pixels(page: Any) -> np.ndarray:
    """What is to be seen, (H, W, 3), 0 to 1."""
    from matplotlib.image import imread

    return np.asarray(imread(io.BytesIO(page.picture())))[:, :, :3]


def colourful(shot: np.ndarray) -> float:
    """Share of the middle of a screenshot that is neither white nor grey."""
    middle = shot[200:500, 100:700]
    return float((np.ptp(middle, axis=2) > 0.3).mean())


def drawn(page: Any) -> np.ndarray:
    """What is to be seen once all has come and is drawn, or after a while."""
    for _ in range(30):
        shot = pixels(page)
        if colourful(shot) > 0.01:
            break
        page.wait(1.0)
    return shot


def alike(shot: np.ndarray, colour: str, off: float = 0.06) -> int:
    """Pixels of nearly this colour."""
    wanted = np.array(rgb(colour)) / 255.0
    return int((np.abs(shot[:500] - wanted).max(axis=2) < off).sum())


def scale(page: Any) -> np.ndarray:
    """Columns of the scale bar's pixels above the panel of a phone, once it is drawn."""
    for _ in range(30):
        off = np.abs(pixels(page)[150:500] - np.array(rgb(PATH)) / 255.0).max(axis=2)
        columns = np.nonzero(off < 0.07)[1]
        if len(columns) > 100:
            break
        page.wait(1.0)
    return columns


@pytest.fixture(scope="module")
def file(site: Site, results: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the results."""
    page = tmp_path_factory.mktemp("page") / "page.html"
    assert run("view", site.map, results, "--html", page) == 0
    return page


@pytest.mark.slow
def test_the_page_shows_the_map_and_the_queries(browser_page: Any, file: Path) -> None:
    page = browser_page
    text = file.read_text("utf-8")
    assert len(text) < 20e6 and not re.search(r"<(script|link|img)[^>]+(src|href)=.?http", text)
    page.open(file.as_uri())
    assert page.until("!!document.querySelector('[role=slider]')")
    output, number = (
        f"document.querySelector('{name}').innerText" for name in ("#segloc", "#scan + output")
    )

    def choose(control: str, query: int, expected: str) -> None:
        page.value(
            f"{{ const control = document.querySelector('{control}'); control.value = {query};"
            "control.dispatchEvent(new Event('input', { bubbles: true })); }"
        )
        page.wait(viewer.SECONDS_A_QUERY + 1.0)  # a page that plays would go on to another
        assert expected in page.value(output)
        assert page.value(number) == f"scan {expected[0]}"

    assert page.until("!!document.querySelector('#scan')")
    choose("#scan", 0, "0: localized")
    before = drawn(page)
    assert colourful(before) > 0.01  # segments, matches, markers
    choose("#segloc select", 1, "1: localized")
    choose("#scan", 2, "2: refused\n\nnot localized: ")
    after = pixels(page)
    assert np.abs(after - before)[:500, :700].max(axis=2).mean() > 0.005  # another query
    assert alike(after, GREEN) + alike(before, GREEN) > 50  # markers of those that are found
    assert page.faults == []
    assert all(each.startswith(("file:", "data:", "blob:")) for each in page.requested)


@pytest.mark.slow
def test_the_page_begins_with_the_first_query_and_the_whole_scale_on_a_phone(
    browser_page: Any, file: Path
) -> None:
    page = browser_page
    phone = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    page.do("Emulation.setDeviceMetricsOverride", **phone)
    try:
        page.open(file.as_uri())
        assert page.until("!!document.querySelector('#scan')"), page.faults
        page.wait(2 * viewer.SECONDS_A_QUERY)
        bar = scale(page)
        assert page.value("document.querySelector('#segloc').innerText").startswith("0: localized")
        assert page.value("document.documentElement.scrollWidth") == 390
    finally:
        page.do("Emulation.clearDeviceMetricsOverride")
    assert len(bar) > 100 and bar.min() > 10


def test_a_named_port_that_is_taken_is_refused(site: Site) -> None:
    pytest.importorskip("viser", reason="the viewer needs the extra 'view'")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(SeglocError, match=f"port {port} cannot be used"):
            viewer.serve(SegmentMap.load(site.map), [], port)


@pytest.mark.slow
def test_results_of_another_map_are_noted(
    site: Site, results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser", reason="the viewer needs the extra 'view'")
    live, summary = tmp_path / "live", results / "summary.json"
    options = ["--map", site.map, "--poses", "poses.tum", "--select", "0:1", "--out", live]
    assert run("live", site.run, *options) == 0
    other = SegmentMap.load(site.map)
    other.add_trajectory(np.eye(4)[None])
    other.save(tmp_path / "other.segmap")

    def noted(prior_map: Path, out: Path) -> bool:
        capsys.readouterr()
        assert run("view", prior_map, out, "--html", tmp_path / "page.html") == 0
        return "localized in another map than" in capsys.readouterr().err

    for out in (results, live):
        assert not noted(site.map, out) and noted(tmp_path / "other.segmap", out)
    whole = summary.read_text("utf-8")
    try:
        summary.write_text(whole.replace("map_id", "before"))
        assert not noted(tmp_path / "other.segmap", results)
    finally:
        summary.write_text(whole)


@pytest.mark.slow
def test_the_server_shows_a_panel_with_the_reason(
    site: Site, results: Path, browser_page: Any
) -> None:
    shown, page = read_results(results), browser_page
    server = viewer.serve(SegmentMap.load(site.map), shown, 0)
    try:
        page.open(f"http://localhost:{server.get_port()}")
        assert page.until("document.body.innerText.includes('0: localized')")
        assert page.value("document.title") == "segloc"
        shot = drawn(page)
    finally:
        server.stop()
    assert colourful(shot) > 0.01  # its segments and matches
    assert "**2: refused**\n\nnot localized: " in viewer.describe(shown[2])


@pytest.mark.slow
def test_the_robot_of_live_is_followed_while_it_drives(site: Site, tmp_path: Path) -> None:
    from segloc.live import State
    from segloc.tools.cli.live import SoFar

    walk, out = open_sequence(site.run, site.run / "poses.tum"), tmp_path / "live"
    assert walk.poses is not None
    api, prior_map = Api(), SegmentMap.load(site.map)
    scene = MapScene(api, prior_map)
    with SoFar(out, walk) as so_far:
        so_far.add(0, State(0.0, Status.LOST, reason="no query yet"))
        assert read_moments(out)[0].T_map_base is None and newest_points(out) is None
        so_far._last = -np.inf
        for k in (3, 4):
            so_far.add(k, State(float(k), Status.LOCALIZED, np.eye(4), walk.poses[k], views=k))
        with (out / SO_FAR).open("a") as file:
            file.write('{"index": 5, "st')  # cut off: being written
        moments, points = read_moments(out), newest_points(out)
        assert [m.state for m in moments] == ["lost", "localized", "localized"] and follows(out)
        assert "4 views agree" in moments[-1].text and points is not None
        draw_moments(scene, moments, points)
        now = api.drawn["/robot/now"].points[0, 0] + prior_map.origin
        assert np.allclose(now[:2], walk.poses[4][:2, 3], atol=1e-3)
        cloud = prior_map.cloud.astype(np.float64)
        nearest = cKDTree(cloud).query(api.drawn["/robot/cloud"].points)[0]
        assert np.median(nearest) < 0.3
    assert list(out.iterdir()) == []
    with pytest.raises(SeglocError, match="no results of `segloc live --out`"):
        read_moments(out)


def test_lost_and_false_stretches_have_a_colour_of_their_own(site: Site) -> None:
    T = np.eye(4)
    states = (("localized", T), ("lost", None), ("localized", T), ("false", T), ("localized", T))
    moments = [Moment(k, state, "", T) for k, (state, T) in enumerate(states)]
    api = Api()
    draw_moments(MapScene(api, SegmentMap.load(site.map)), moments)
    colours = api.colours["/robot/trajectory"][:, 0].tolist()
    assert len({tuple(each) for each in colours}) == 3 and len(colours) == 3


@pytest.mark.slow
def test_a_finished_drive_is_shown_in_one_page(site: Site, tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="the viewer needs the extra 'view'")
    out, page = tmp_path / "live", tmp_path / "live.html"
    options = ["--map", site.map, "--poses", "poses.tum", "--select", "0:4", "--out", out]
    assert run("live", site.run, *options) == 0
    assert sorted(file.name for file in out.iterdir()) == [
        "poses.tum", "states.jsonl", "summary.json"
    ]  # fmt: skip
    assert [moment.index for moment in read_moments(out)] == [0, 1, 2, 3, 4]
    assert run("view", site.map, out, "--html", page) == 0
    text = page.read_text("utf-8")
    assert "<b>5 scans</b>" in text and re.search(r"<td>localized</td><td>\d</td>", text)
