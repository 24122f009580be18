"""A map and queries in the browser: by a server with a panel, or as one file with a slider."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from ..errors import MissingDependency, SeglocError
from ..map.segment_map import SegmentMap
from ..types import Float64
from .drawn_fast import draw_fast, drawn_fast
from .following import Moment, draw_moments, newest_points, read_moments
from .panel import LEGEND, ROBOT_LEGEND, with_panel, with_states
from .results import Shown
from .scene import FIXED, OF_QUERY, ROBOT, MapScene

SECONDS_A_QUERY = 2.0
_EVERY_S = 0.5
_BACK_M, _UP_M, _IN_VIEW_M = 45.0, 60.0, 95.0


def html(prior_map: SegmentMap, queries: Sequence[Shown]) -> str:
    """One self-contained page: the map with all queries, and one after another in detail.

    Its slider goes over the queries of which stages were kept, or else over all.

    Raises
    ------
    MissingDependency
        If viser is not installed.
    """
    server = _server("127.0.0.1", 0)
    try:
        scene = MapScene(server.scene, prior_map)
        shown = _in_detail(queries)
        _look_at_all(server, scene, shown)
        scene.draw_map()
        scene.draw_queries(queries)
        recorded = server.get_scene_serializer()
        for query in shown:
            scene.draw_query(query)
            recorded.insert_sleep(SECONDS_A_QUERY)
        page = drawn_fast(str(recorded.as_html()))
        return with_panel(page, shown, SECONDS_A_QUERY) if shown else page
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


def serve(prior_map: SegmentMap, queries: Sequence[Shown], port: int) -> Any:
    """Start a server on this machine alone, with a panel to choose queries and layers by.

    Returns
    -------
    viser.ViserServer
        Which runs in threads of its own until it is stopped.

    Raises
    ------
    MissingDependency
        If viser is not installed.
    SeglocError
        If the port is in use.
    """
    server = _server("127.0.0.1", port)
    draw_fast(server)
    shown = _in_detail(queries)
    scene = _map_in_view(server, prior_map, shown[0] if shown else None)
    scene.draw_queries(queries)
    if shown:
        _add_choice(server, scene, shown)
    detailed = any(query.seen is not None for query in shown)
    _add_layers(server, scene, (*FIXED, *OF_QUERY) if detailed else FIXED)
    return server


def follow(prior_map: SegmentMap, folder: Path, port: int) -> Any:
    """Start a server that shows where the robot of ``segloc live --out`` is, as it is written.

    Returns
    -------
    viser.ViserServer
        Which runs in threads of its own until it is stopped.

    Raises
    ------
    MissingDependency
        If viser is not installed.
    SeglocError
        If the port is in use, or the folder is none of ``segloc live``.
    """
    read_moments(folder)
    server = _server("127.0.0.1", port)
    draw_fast(server)
    scene = _map_in_view(server, prior_map)
    text = server.gui.add_markdown("")
    server.gui.add_markdown(ROBOT_LEGEND)
    _add_layers(server, scene, ROBOT)
    shown: list[int] = []

    def refresh() -> None:
        moments = read_moments(folder)
        if shown == [len(moments)]:
            return
        shown[:] = [len(moments)]
        with server.atomic():
            draw_moments(scene, moments, newest_points(folder))
        text.content = moments[-1].said if moments else "nothing said yet"

    refresh()
    Thread(target=_keep_on, args=(server, refresh), daemon=True).start()
    return server


def _keep_on(server: Any, refresh: Callable[[], None]) -> None:
    while True:
        time.sleep(_EVERY_S)
        try:
            refresh()
        except SeglocError:  # between one file and the next
            continue
        except RuntimeError:  # the server is stopped
            return


def html_of_robot(prior_map: SegmentMap, moments: Sequence[Moment]) -> str:
    """One self-contained page: the map, and where the robot was.

    Raises
    ------
    MissingDependency
        If viser is not installed.
    """
    server = _server("127.0.0.1", 0)
    try:
        scene = _map_in_view(server, prior_map)
        draw_moments(scene, moments)
        page = drawn_fast(str(server.get_scene_serializer().as_html()))
        return with_states(page, [moment.state for moment in moments])
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


def _map_in_view(server: Any, prior_map: SegmentMap, query: Shown | None = None) -> MapScene:
    """The map drawn, and looked at where a query is."""
    scene = MapScene(server.scene, prior_map)
    _look(server, scene, query)
    scene.draw_map()
    return scene


def _add_layers(server: Any, scene: MapScene, layers: Sequence[str]) -> None:
    with server.gui.add_folder("shown"):
        for layer in layers:
            box = server.gui.add_checkbox(layer, True)

            def change(_: Any, box: Any = box, layer: str = layer) -> None:
                scene.show(layer, bool(box.value))

            box.on_update(change)


def _add_choice(server: Any, scene: MapScene, queries: Sequence[Shown]) -> None:
    last = len(queries) - 1
    slider = server.gui.add_slider("query", min=0, max=max(last, 1), step=1, initial_value=0)
    head = server.gui.add_markdown("")
    with server.gui.add_folder("stages and confidence", expand_by_default=False):
        text = server.gui.add_markdown("")
    server.gui.add_markdown(LEGEND)

    def choose(_: Any) -> None:
        query = queries[min(int(slider.value), last)]
        with server.atomic():
            scene.draw_query(query)
        head.content, text.content = described(query), stages(query)
        for client in server.get_clients().values():
            client.camera.position, client.camera.look_at = _from(scene, query)

    slider.on_update(choose)
    choose(None)


def described(query: Shown) -> str:
    """Markdown of one query: its outcome and its verdict."""
    said = query.said if query.seen is None else query.seen.verdict
    return f"**{query.index}: {query.outcome}**\n\n{said}"


def stages(query: Shown) -> str:
    """Markdown of one query: a line for each stage, and for each part of the confidence."""
    if query.seen is None:
        return ""
    lines = [f"- {line}" for line in query.seen.stages]
    if query.seen.parts:
        lines += ["", "confidence, in log-odds", ""]
        lines += [f"- {line}" for line in query.seen.parts]
    return "\n".join(lines)


def _in_detail(queries: Sequence[Shown]) -> list[Shown]:
    """Those that something was kept of; all where nothing was."""
    return [query for query in queries if query.seen is not None] or list(queries)


def _look(server: Any, scene: MapScene, query: Shown | None) -> None:
    server.scene.set_up_direction("+z")
    camera = server.initial_camera
    camera.position, camera.look_at = _from(scene, query)


def _look_at_all(server: Any, scene: MapScene, queries: Sequence[Shown]) -> None:
    """From where all queries are in view."""
    _look(server, scene, queries[0] if queries else None)
    if len(queries) < 2:
        return
    places = np.array([scene.middle(query) for query in queries])
    middle, extent = (places.min(axis=0) + places.max(axis=0)) / 2, np.ptp(places[:, :2], axis=0)
    back = max(1.0, float(np.linalg.norm(extent)) / _IN_VIEW_M)
    camera = server.initial_camera
    camera.position = middle + back * np.array([0.0, -_BACK_M, _UP_M])
    camera.look_at = middle


def _from(scene: MapScene, query: Shown | None) -> tuple[Float64, Float64]:
    """Where the camera is, and what it looks at."""
    middle = scene.middle(query)
    return middle + np.array([0.0, -_BACK_M, _UP_M]), middle


def _server(host: str, port: int) -> Any:
    try:
        import viser
    except ImportError as error:
        raise MissingDependency("viser", "view", "viewing") from error
    try:
        with redirect_stdout(StringIO()):  # it greets, even if told not to
            return viser.ViserServer(host=host, port=port, verbose=False)
    except OSError as error:
        raise SeglocError(f"port {port} cannot be used: {error.strerror or error}") from error
