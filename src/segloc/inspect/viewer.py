"""View a map and queries in the browser: by a server with a panel, or one file with a slider.

All need viser, and raise ``MissingDependency`` without it.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from html import escape
from io import StringIO
from pathlib import Path
from string import Template
from threading import Thread
from typing import Any

import numpy as np

from ..errors import MissingDependency, SeglocError
from ..map.segment_map import SegmentMap
from ..system.text import counted
from ..types import Float64
from .following import Moment, draw_moments, newest_points, read_moments
from .pictures import DARK
from .results import Shown
from .scene import COLOURS, FIXED, OF_QUERY, ROBOT, MapScene

SECONDS_A_QUERY = 2.0
_EVERY_S = 0.5
_BACK_M, _UP_M, _IN_VIEW_M = 45.0, 60.0, 95.0

LEGEND = (
    "Dots: queries found (green), refused (orange), false (red). Cloud: on the map (green), not on "
    "it (red). Upright green lines: matches that agree."
)
ROBOT_LEGEND = (
    "Its path: localized (green), candidate or degraded (orange); the large dot is its end."
)
_STYLE = Template("""
<style>
#segloc { position: fixed; top: 1em; right: 1em; z-index: 900; width: 23em; max-width: 40vw;
  max-height: 80vh; overflow-y: auto; background: #fffffff2; color: $dark;
  border-radius: 6px; padding: .8em 1em;
  font: 13px/1.4 system-ui, sans-serif; box-shadow: 0 1px 8px #0003 }
#segloc select { width: 100%; font: inherit } #segloc > b { display: block; margin: .6em 0 .3em }
#segloc p { margin: .3em 0 .6em } #segloc td { padding: .1em 0; vertical-align: top }
#segloc table { border-collapse: collapse; border-top: 1px solid #0002; width: 100% }
#segloc td:first-child { padding-right: .7em; white-space: nowrap; opacity: .75 }
#segloc .parts td:first-child { text-align: right; font-variant-numeric: tabular-nums }
#segloc small { display: block; border-top: 1px solid #0002; margin-top: .5em; padding-top: .4em }
</style>
""").substitute(dark=DARK)
# The page's player shows each query for some seconds; its slider and its field hold the time.
_PANEL = Template("""
<div id="segloc"><select aria-label="query"></select><b></b><p></p><table></table>
<b>confidence, in log-odds</b><table class="parts"></table><small>$legend</small></div>
<script>
(() => {
  const queries = $queries, seconds = $seconds;
  const [box, head, summary, stages, title, parts] =
    ["select", "b", "p", "table", "p ~ b", ".parts"].map((name) =>
      document.querySelector("#segloc > " + name));
  const fill = (table, rows) => table.replaceChildren(...rows.map((row) => {
    const line = document.createElement("tr");
    row.forEach((text) => line.insertCell().textContent = text);
    return line;
  }));
  queries.forEach((q, k) => box.add(new Option(q.index + ": " + q.outcome, k)));
  let shown = -1;
  const show = (k) => {
    if (k === shown || !queries[k]) return;
    shown = k;
    const q = queries[k];
    box.value = k;
    head.textContent = q.index + ": " + q.outcome;
    head.style.color = q.colour;
    summary.textContent = q.summary;
    fill(stages, q.stages);
    fill(parts, q.parts);
    title.hidden = parts.hidden = !q.parts.length;
  };
  const time = () => document.querySelector("[role=slider]")?.getAttribute("aria-valuenow");
  setInterval(() => {
    const now = time();
    if (now != null) show(Math.min(queries.length - 1, Math.floor(Number(now) / seconds + 1e-6)));
  }, 150);
  box.addEventListener("change", () => {
    const field = document.querySelector("input[type=text], input[inputmode]");
    if (!field) return show(Number(box.value));
    const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
    field.focus();
    set.call(field, String(seconds * (Number(box.value) + 0.5)));
    field.dispatchEvent(new Event("input", { bubbles: true }));
    field.dispatchEvent(new Event("change", { bubbles: true }));
    field.blur();
  });
  show(0);
})();
</script>
""")
# Points need no anti-aliasing. Without it 200 000 points are drawn two to three times as fast by a
# processor.
_SHARP = """
(() => {
  const get = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, options) {
    const sharp = /webgl/.test(kind) ? { ...(options || {}), antialias: false } : options;
    return get.call(this, kind, sharp);
  };
})();
"""

# While the view moves, draw as many points as time allows, then all of them. A fence measures the
# time, so a GPU always draws all. Points come in random order, so any part is a thinned cloud.
_THINNED = """
(() => {
  if (window.thinsWhatMoves) return;
  window.thinsWhatMoves = true;
  const TARGET_MS = 100, FEWEST = 15000, SETTLES_MS = 400, POLL_MS = 8;
  let held = false, until = 0, costOfPoint = 0, fence = null;
  const still = () => { held = false; until = performance.now() + SETTLES_MS; };
  addEventListener("pointerdown", (e) => { held = e.target.tagName === "CANVAS"; }, true);
  for (const name of ["pointerup", "pointercancel", "blur"]) addEventListener(name, still, true);
  addEventListener("wheel", still, { capture: true, passive: true });
  const learn = (gl, points, begun) => setTimeout(() => {
    if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED) return learn(gl, points, begun);
    gl.deleteSync(fence);
    fence = null;
    const cost = (performance.now() - begun) / points;
    costOfPoint = costOfPoint ? (costOfPoint + cost) / 2 : cost;
  }, POLL_MS);
  const draw = WebGL2RenderingContext.prototype.drawArrays;
  WebGL2RenderingContext.prototype.drawArrays = function (mode, first, count) {
    if (mode !== this.POINTS || count <= FEWEST) return draw.call(this, mode, first, count);
    const moves = held || performance.now() < until;
    const inTime = Math.max(FEWEST, Math.floor(TARGET_MS / (costOfPoint || 1e-9)));
    const drawn = moves ? Math.min(count, inTime) : count;
    draw.call(this, mode, first, drawn);
    if (fence) return;
    fence = this.fenceSync(this.SYNC_GPU_COMMANDS_COMPLETE, 0);
    this.flush();
    learn(this, drawn, performance.now());
  };
})();
"""


def html(prior_map: SegmentMap, queries: Sequence[Shown]) -> str:
    """Return one self-contained page: the map with all queries, and a slider for details.

    The slider covers the queries with stored stages, or else all.
    """
    with _temporary_server() as server:
        scene = MapScene(server.scene, prior_map)
        shown = _in_detail(queries)
        _look_at_all(server, scene, shown)
        scene.draw_map()
        scene.draw_queries(queries)
        recorded = server.get_scene_serializer()
        for query in shown:
            scene.draw_query(query)
            recorded.insert_sleep(SECONDS_A_QUERY)
        page = _drawn_fast(str(recorded.as_html()))
        return _with_panel(page, shown) if shown else page


def serve(prior_map: SegmentMap, queries: Sequence[Shown], port: int) -> Any:
    """Start a server on this machine only, with a panel to choose queries and layers.

    Returns
    -------
    viser.ViserServer
        Runs in its own threads until it is stopped.

    Raises
    ------
    SeglocError
        If the port is in use.
    """
    server = _server(port)
    _draw_fast(server)
    shown = _in_detail(queries)
    scene = _map_in_view(server, prior_map, shown[0] if shown else None)
    scene.draw_queries(queries)
    if shown:
        _add_choice(server, scene, shown)
    detailed = any(query.stages is not None for query in shown)
    _add_layers(server, scene, (*FIXED, *OF_QUERY) if detailed else FIXED)
    return server


def follow(prior_map: SegmentMap, folder: Path, port: int) -> Any:
    """Start a server that follows the robot of ``segloc live --out``.

    Returns
    -------
    viser.ViserServer
        Runs in its own threads until it is stopped.

    Raises
    ------
    SeglocError
        If the port is in use, or the folder is not an output of ``segloc live``.
    """
    read_moments(folder)
    server = _server(port)
    _draw_fast(server)
    scene = _map_in_view(server, prior_map)
    text = server.gui.add_markdown("")
    server.gui.add_markdown(ROBOT_LEGEND)
    _add_layers(server, scene, ROBOT)
    shown = -1

    def refresh() -> None:
        nonlocal shown
        moments = read_moments(folder)
        if shown == len(moments):
            return
        shown = len(moments)
        with server.atomic():
            draw_moments(scene, moments, newest_points(folder))
        text.content = moments[-1].text if moments else "no results yet"

    refresh()
    Thread(target=_keep_on, args=(server, refresh), daemon=True).start()
    return server


def _keep_on(server: Any, refresh: Callable[[], None]) -> None:
    while True:
        time.sleep(_EVERY_S)
        try:
            refresh()
        except SeglocError:  # between two files
            continue
        except RuntimeError:  # the server was stopped
            return


def html_of_robot(prior_map: SegmentMap, moments: Sequence[Moment]) -> str:
    """Return one self-contained page: the map, and the robot's trajectory."""
    with _temporary_server() as server:
        scene = _map_in_view(server, prior_map)
        draw_moments(scene, moments)
        page = _drawn_fast(str(server.get_scene_serializer().as_html()))
        return _with_states(page, [moment.state for moment in moments])


def _map_in_view(server: Any, prior_map: SegmentMap, query: Shown | None = None) -> MapScene:
    """Draw the map, and point the camera at a query."""
    scene = MapScene(server.scene, prior_map)
    _look(server, scene, query)
    scene.draw_map()
    return scene


def _add_layers(server: Any, scene: MapScene, layers: Sequence[str]) -> None:
    with server.gui.add_folder("shown"):
        for layer in layers:
            box = server.gui.add_checkbox(layer, layer not in OF_QUERY)
            scene.show(layer, bool(box.value))

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
    """Describe one query in Markdown: its outcome and summary."""
    text = query.text if query.stages is None else query.stages.summary
    return f"**{query.index}: {query.outcome}**\n\n{text}"


def stages(query: Shown) -> str:
    """Describe one query in Markdown: stages, and parts of the confidence."""
    if query.stages is None:
        return ""
    lines = [f"- {line}" for line in query.stages.steps]
    if query.stages.parts:
        lines += ["", "confidence, in log-odds", ""]
        lines += [f"- {line}" for line in query.stages.parts]
    return "\n".join(lines)


def _in_detail(queries: Sequence[Shown]) -> list[Shown]:
    """Return the queries with stored stages, or all if there are none."""
    return [query for query in queries if query.stages is not None] or list(queries)


def _look(server: Any, scene: MapScene, query: Shown | None) -> None:
    server.scene.set_up_direction("+z")
    camera = server.initial_camera
    camera.position, camera.look_at = _from(scene, query)


def _look_at_all(server: Any, scene: MapScene, queries: Sequence[Shown]) -> None:
    """Point the camera so that all queries are in view."""
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
    """Return the camera's position and target."""
    middle = scene.middle(query)
    return middle + np.array([0.0, -_BACK_M, _UP_M]), middle


def _server(port: int) -> Any:
    """Start a server on this machine only."""
    try:
        import viser
    except ImportError as error:
        raise MissingDependency("viser", "view", "viewing") from error
    try:
        with redirect_stdout(StringIO()):  # it prints even in quiet mode
            return viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
    except OSError as error:
        raise SeglocError(f"port {port} cannot be used: {error.strerror or error}") from error


@contextmanager
def _temporary_server() -> Iterator[Any]:
    """Start a server to draw a page with."""
    server = _server(0)
    try:
        yield server
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


def _with_panel(page: str, queries: Sequence[Shown]) -> str:
    """Add a panel to a page of viser's player, with queries for ``SECONDS_A_QUERY`` each."""
    records = [
        {
            "index": query.index,
            "outcome": query.outcome,
            "colour": COLOURS[query.outcome],
            "summary": query.text if shown is None else shown.summary,
            "stages": [] if shown is None else [line.split(": ", 1) for line in shown.steps],
            "parts": [] if shown is None else [line.split(" ", 1) for line in shown.parts],
        }
        for query in queries
        for shown in (query.stages,)
    ]
    text = json.dumps(records).replace("<", "\\u003c")  # escape the end of the script
    return _with(page, _PANEL.substitute(queries=text, seconds=SECONDS_A_QUERY, legend=LEGEND))


def _with_states(page: str, states: Sequence[str]) -> str:
    """Add counts of states to a page of a robot."""
    rows = "".join(
        f"<tr><td>{escape(state)}</td><td>{count}</td></tr>"
        for state, count in Counter(states).most_common()
    )
    counts = (
        f"<b>{counted(len(states), 'scans')}</b><table>{rows}</table><small>{ROBOT_LEGEND}</small>"
    )
    return _with(page, f'<div id="segloc">{counts}</div>')


def _with(page: str, panel: str) -> str:
    head, end, tail = page.rpartition("</body>")
    return f"{head}{_STYLE}{panel}{end}{tail}" if end else f"{page}{_STYLE}{panel}"


def _drawn_fast(page: str) -> str:
    """Add scripts to a viser page that draw many points faster."""
    head, start, tail = page.partition("<head>")
    added = f"<script>{_SHARP}{_THINNED}</script>"
    return f"{head}{start}{added}{tail}" if start else page


def _draw_fast(server: Any) -> None:
    """Thin moving clouds in the pages of a viser server, if its version supports it."""
    with suppress(ImportError, AttributeError):
        from viser._messages import RunJavascriptMessage

        server.gui._websock_interface.queue_message(RunJavascriptMessage(source=_THINNED))
