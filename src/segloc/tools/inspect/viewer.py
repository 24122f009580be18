"""View a map and queries in the browser: by a server with a panel, or one file with a slider.

All need viser, and raise ``MissingDependency`` without it.
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from html import escape
from io import StringIO
from pathlib import Path
from socket import create_server
from string import Template
from threading import Thread
from typing import Any

import numpy as np

from ...errors import SeglocError, requires
from ...map.segment_map import SegmentMap
from ...system.text import quantity
from ...types import Float64, Pose
from .following import COLOURS as OF_STATES
from .following import Moment, draw_moments, newest_points, read_moments
from .pictures import BLUE, DARK, GREEN, PALE, RED, VIOLET, rgb
from .results import Shown
from .scene import COLOURS, FIXED, OF_QUERY, OTHER, ROBOT, RUNNER_UP, MapScene
from .trace import Tables

SECONDS_A_QUERY = 2.0
_EVERY_S = 0.5
_MAX_FARTHER, _SOUTH = 1.6, 0.45  # of the camera on upright screens, in its distance
_HOST, _PORT = "127.0.0.1", 8080

_OF_CLOUD = (
    (GREEN, "cloud on the map, inliers"),
    (RED, "cloud off the map"),
    (VIOLET, RUNNER_UP),
)
_STYLE = Template("""
<style>
#segloc { position: fixed; top: 1em; right: 1em; z-index: 900; width: 23em; max-width: 40vw;
  max-height: 80vh; overflow-y: auto; background: #fffffff2; color: $dark;
  border-radius: 6px; padding: .8em 1em; box-sizing: border-box;
  font: 13px/1.4 system-ui, sans-serif; box-shadow: 0 1px 8px #0003 }
#segloc select { width: 100%; font: inherit } #segloc > b { display: block; margin: .6em 0 .3em }
#segloc p { margin: .3em 0 .6em } #segloc td { padding: .1em 0; vertical-align: top }
#segloc table { border-collapse: collapse; border-top: 1px solid #8884; width: 100% }
#segloc td:first-child { padding-right: .7em; white-space: nowrap; opacity: .75 }
#segloc .parts td:first-child { text-align: right; font-variant-numeric: tabular-nums }
#segloc small { display: block; border-top: 1px solid #8884; margin-top: .5em; padding-top: .4em }
#scan { flex-grow: 1; min-width: 0; accent-color: $blue }
#scan + output { font: 12px system-ui, sans-serif; white-space: nowrap }
@media (prefers-color-scheme: dark) { #segloc { background: #1a1b1ef2; color: $pale } }
@media (max-width: 40em) { #segloc { top: auto; bottom: 4em; left: 0; right: 0; width: auto;
  max-width: none; max-height: 32vh; border-radius: 0 } }
</style>
""").substitute(dark=DARK, pale=PALE, blue=BLUE)
_LEGEND_STYLE = """<style>#legend { padding: 0 1em .6em; font-size: 13px }
@media (max-width: 40em) { #legend { display: none } }</style>"""
# viser has options for the dark theme, of its address and of its pages, but follows no preference.
_DARK = "matchMedia('(prefers-color-scheme: dark)').matches"
_OPENED = f"""
document.title = "segloc";
if ({_DARK} && !/[?&]darkMode/.test(location.search)) location.search += "&darkMode";
"""
# viser's player begins by playing, and its slider and field hold seconds: in their place the page
# has a slider over queries with their scan numbers. The field takes the time of the chosen query,
# which pauses the player.
_PANEL = Template("""
<div id="segloc"><select aria-label="query"></select><b></b><p></p><table></table>
<b>evidence, in log-odds</b><table class="parts"></table><small>$legend</small></div>
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
  const slider = document.createElement("input"), number = document.createElement("output");
  Object.assign(slider, { id: "scan", type: "range", max: queries.length - 1, ariaLabel: "scan" });
  let shown = -1, time = null, field = null;
  const show = (k) => {
    if (k === shown || !queries[k]) return;
    shown = k;
    const q = queries[k];
    box.value = slider.value = k;
    number.textContent = "scan " + q.index;
    head.textContent = q.index + ": " + q.outcome;
    head.style.color = q.colour;
    summary.textContent = q.summary;
    fill(stages, q.stages);
    fill(parts, q.parts);
    title.hidden = parts.hidden = !q.parts.length;
  };
  const choose = (k) => {
    show(k);
    const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
    set.call(field, String(seconds * (k + 0.52)));  // no text that the field has, of one decimal
    field.dispatchEvent(new Event("input", { bubbles: true }));
  };
  const start = () => {
    const theirs = document.querySelector(".mantine-Slider-root");
    if (!theirs) return;
    const beside = theirs.previousElementSibling;
    time = theirs.querySelector("[role=slider]");
    field = beside.querySelector("input");
    theirs.style.display = beside.style.display = "none";
    theirs.after(slider, number);
    choose(0);
    for (const each of [box, slider])
      each.addEventListener("input", () => choose(Number(each.value)));
  };
  setInterval(() => {
    if (!time) return start();
    const now = Number(time.getAttribute("aria-valuenow"));
    show(Math.min(queries.length - 1, Math.floor(now / seconds + 1e-6)));
  }, 150);
  show(0);
})();
</script>
""")

# A camera in the address of viser's page comes before that of the page itself.
_UPRIGHT = Template("""
if (matchMedia("(orientation: portrait)").matches) {
  const camera = $camera, get = URLSearchParams.prototype.get;
  URLSearchParams.prototype.get = function (name) {
    return get.call(this, name) ?? camera[name] ?? null;
  };
}
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
        scene, legend, shown = _drawn(server, prior_map, queries)
        _look_from(server, scene.in_view(*map(scene.middle, shown)))
        recorded = server.get_scene_serializer()
        for query in shown:
            scene.draw_query(query)
            recorded.insert_sleep(SECONDS_A_QUERY)
        return _page(server, recorded, _panel(shown, legend) if shown else "")


def serve(prior_map: SegmentMap, queries: Sequence[Shown], port: int | None = None) -> Any:
    """Start a server on this machine only, with a panel to choose queries and layers.

    Parameters
    ----------
    prior_map : SegmentMap
    queries : sequence of Shown
    port : int, optional
        0 for any free port; by default 8080, or else the next free port.

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
    scene, legend, shown = _drawn(server, prior_map, queries)
    if shown:
        _add_choice(server, scene, shown)
    else:
        _look_from(server, scene.in_view())
    detailed = any(query.stages is not None for query in shown)
    _add_layers(server, scene, (*FIXED, *OF_QUERY[:-1]) if detailed else FIXED, legend)
    return server


def follow(prior_map: SegmentMap, folder: Path, port: int | None = None) -> Any:
    """Start a server that follows the robot of ``segloc live --out``.

    Parameters
    ----------
    prior_map : SegmentMap
    folder : path
    port : int, optional
        As of :func:`serve`.

    Returns
    -------
    viser.ViserServer
        Runs in its own threads until it is stopped.

    Raises
    ------
    SeglocError
        If the port is in use, or the folder is not an output of ``segloc live``.
    """
    moments = read_moments(folder)
    server = _server(port)
    scene = MapScene(server.scene, prior_map)
    legend = (*scene.draw_map(), *_of_robot())
    _look_at_robot(server, scene, moments)
    text = server.gui.add_markdown("")
    _add_layers(server, scene, ROBOT, legend)
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
        scene = MapScene(server.scene, prior_map)
        legend = _swatches((*scene.draw_map(), *_of_robot()))
        _look_at_robot(server, scene, moments)
        draw_moments(scene, moments)
        counts = Counter(moment.state for moment in moments)
        rows = "".join(
            f"<tr><td>{escape(state)}</td><td>{count}</td></tr>"
            for state, count in counts.most_common()
        )
        head = f"<b>{quantity(len(moments), 'scans')}</b><table>{rows}</table>"
        panel = f'<div id="segloc">{head}<small>{legend}</small></div>'
        return _page(server, server.get_scene_serializer(), panel)


def _look_at_robot(server: Any, scene: MapScene, moments: Sequence[Moment]) -> None:
    poses = [moment.T_map_base for moment in moments if moment.T_map_base is not None]
    _look_from(server, scene.in_view(*(scene.local(T[:3, 3]) for T in poses)))


def _look_from(server: Any, view: tuple[Float64, Float64]) -> None:
    """Point the cameras of the pages that are open, and of those opened later."""
    server.initial_camera.position, server.initial_camera.look_at = view
    for client in server.get_clients().values():
        _look(client.camera, view)


def _look(camera: Any, view: tuple[Float64, Float64]) -> None:
    """Point one camera."""
    camera.position, camera.look_at = _framed(view, 1.0 / camera.aspect)


def _framed(view: tuple[Float64, Float64], farther: float) -> tuple[Float64, Float64]:
    """Return the camera; on upright screens from farther, with the place above the panel."""
    position, target = view
    position = target + min(max(1.0, farther), _MAX_FARTHER) * (position - target)
    south = (farther > 1.0) * _SOUTH * np.array([0.0, position[1] - target[1], 0.0])
    return position + south, target + south


def _add_layers(
    server: Any, scene: MapScene, layers: Sequence[str], legend: Sequence[tuple[str, str]]
) -> None:
    server.gui.add_html(f'{_LEGEND_STYLE}<div id="legend">{_swatches(legend)}</div>')
    with server.gui.add_folder("layers", expand_by_default=False):
        for layer in layers:
            box = server.gui.add_checkbox(layer, layer != OTHER)

            def change(_: Any, box: Any = box, layer: str = layer) -> None:
                scene.show(layer, bool(box.value))

            box.on_update(change)


def _add_choice(server: Any, scene: MapScene, queries: Sequence[Shown]) -> None:
    """Add a slider over scan numbers: it rests on those of queries only."""
    numbers = [query.index for query in queries]
    low, high = min(numbers), max(numbers)
    slider = server.gui.add_slider(
        "scan", min=low, max=max(high, low + 1), step=1, initial_value=numbers[0]
    )
    head = server.gui.add_markdown("")
    looked_at = server.gui.add_button_group("look at", ("pose", RUNNER_UP))
    with server.gui.add_folder("stages and evidence", expand_by_default=False):
        text = server.gui.add_markdown("")
    chosen = queries[0]

    def choose(_: Any) -> None:
        nonlocal chosen
        number, step = int(slider.value), 1 if slider.value > chosen.index else -1
        if number not in numbers:  # go on to the next in the direction of the movement
            ahead = [each for each in numbers if step * (each - number) > 0]
            number = min(ahead, key=lambda each: abs(each - number), default=chosen.index)
            slider.value = number
        chosen = queries[numbers.index(number)]
        with server.atomic():
            scene.draw_query(chosen)
            look_at(None)
        head.content, text.content = describe(chosen), stages(chosen)
        looked_at.visible = runner_up() is not None

    def runner_up() -> Pose | None:
        return None if chosen.stages is None else chosen.stages.T_map_other

    def look_at(other: Pose | None) -> None:
        scene.show(RUNNER_UP, other is not None)
        places = [] if other is None else [scene.local(other[:3, 3])]
        _look_from(server, scene.in_view(scene.middle(chosen), *places))

    slider.on_update(choose)
    looked_at.on_click(lambda _: look_at(runner_up() if looked_at.value == RUNNER_UP else None))
    choose(None)


def describe(query: Shown) -> str:
    """Describe one query in Markdown: its outcome and summary."""
    text = query.text if query.stages is None else query.stages.summary
    return f"**{query.index}: {query.outcome}**\n\n{text}"


def stages(query: Shown) -> str:
    """Describe one query in Markdown: stages and evidence."""
    if query.stages is None:
        return ""
    lines = [f"- {line}" for line in query.stages.steps]
    for title, rows in query.stages.tables:
        lines += ["", f"**{title}**, log-odds", ""]
        lines += [f"- {log_odds} {label}: {words}" for log_odds, label, words in rows]
    return "\n".join(lines)


def _drawn(
    server: Any, prior_map: SegmentMap, queries: Sequence[Shown]
) -> tuple[MapScene, tuple[tuple[str, str], ...], list[Shown]]:
    """Draw map and queries; return the legend, and the queries with stages, or else all."""
    scene = MapScene(server.scene, prior_map)
    of_map = scene.draw_map()
    scene.draw_queries(queries)
    outcomes = {query.outcome for query in queries}
    found = [(colour, name) for name, colour in COLOURS.items() if name in outcomes]
    detailed = [query for query in queries if query.stages is not None]
    return scene, (*of_map, *found, *(_OF_CLOUD if detailed else ())), detailed or list(queries)


def _of_robot() -> tuple[tuple[str, str], ...]:
    names: dict[str, list[str]] = {}
    for state, colour in OF_STATES.items():
        names.setdefault(colour, []).append(state)
    return tuple((colour, " or ".join(each)) for colour, each in names.items())


def _swatches(legend: Sequence[tuple[str, str]]) -> str:
    """Return a legend as HTML."""
    return " ".join(
        f'<span style="white-space: nowrap; margin-right: .8em">'
        f'<span style="color: {colour}">&#9632;</span> {escape(words)}</span>'
        for colour, words in legend
    )


def _server(port: int | None) -> Any:
    """Start a server on this machine only."""
    with requires("viser", "view", "viewing"):
        import viser
    try:
        if port is not None:  # viser goes on to the next free port without a word
            create_server((_HOST, port)).close()
    except OSError as error:
        reason = os.strerror(error.errno or 0)
        raise SeglocError(f"port {port} cannot be used ({reason}): choose another") from error
    with redirect_stdout(StringIO()):  # it prints even in quiet mode
        server = viser.ViserServer(
            host=_HOST, port=_PORT if port is None else port, label="segloc", verbose=False
        )
    # A connection that is closed without a request is a traceback there.
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=rgb(BLUE))
    server.scene.set_up_direction("+z")
    opened = server.initial_camera

    def meet(client: Any) -> None:
        """Point the camera of a new page, and again when the page turns out to be upright."""
        camera, looked = client.camera, None

        def look(_: Any) -> None:
            nonlocal looked
            if (is_upright := camera.aspect < 1.0) is not looked:
                looked = is_upright
                _look(camera, (opened.position, opened.look_at))

        look(None)
        camera.on_update(look)

    server.on_client_connect(meet)
    with suppress(ImportError, AttributeError):  # not in all of its versions
        from viser._messages import RunJavascriptMessage

        server.gui._websock_interface.queue_message(RunJavascriptMessage(source=_OPENED + _THINNED))
    return server


@contextmanager
def _temporary_server() -> Iterator[Any]:
    """Start a server to draw a page with."""
    server = _server(0)
    try:
        yield server
    finally:
        with redirect_stdout(StringIO()):
            server.stop()


def _panel(queries: Sequence[Shown], legend: Sequence[tuple[str, str]]) -> str:
    """Return a panel for viser's player, with queries for ``SECONDS_A_QUERY`` each."""
    records = [
        {
            "index": query.index,
            "outcome": query.outcome,
            "colour": COLOURS[query.outcome],
            "summary": query.text if shown is None else shown.summary,
            "stages": [] if shown is None else [line.split(": ", 1) for line in shown.steps],
            "parts": [] if shown is None else _flat(shown.tables),
        }
        for query in queries
        for shown in (query.stages,)
    ]
    text = json.dumps(records).replace("<", "\\u003c")  # escape the end of the script
    return _PANEL.substitute(queries=text, seconds=SECONDS_A_QUERY, legend=_swatches(legend))


def _flat(tables: Tables) -> list[list[str]]:
    """Return one table, with a row for each title."""
    return [
        row
        for title, rows in tables
        for row in (
            ["", title],
            *([log_odds, f"{label}: {text}"] for log_odds, label, text in rows),
        )
    ]


def _page(server: Any, recorded: Any, panel: str) -> str:
    """Return a page of viser's player with a panel, the title and the reader's theme."""
    view = server.initial_camera.position, server.initial_camera.look_at
    names = "initialCameraPosition", "initialCameraLookAt"
    points = (",".join(map(str, point)) for point in _framed(view, _MAX_FARTHER))
    upright = _UPRIGHT.substitute(camera=json.dumps(dict(zip(names, points, strict=True))))
    page = str(recorded.as_html()).replace("<title>Viser</title>", "<title>segloc</title>", 1)
    page = page.replace("<head>", f"<head><script>{upright}{_SHARP}{_THINNED}</script>", 1)
    page = page.replace("{darkMode:false}", f"{{darkMode:{_DARK}}}", 1)
    head, end, tail = page.rpartition("</body>")
    return f"{head}{_STYLE}{panel}{end}{tail}" if end else f"{page}{_STYLE}{panel}"
