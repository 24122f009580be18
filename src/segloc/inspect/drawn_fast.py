"""What is added to viser's pages so that many points move smoothly, even without a GPU."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

# Edges of points need no smoothing. It takes most of the time where a processor draws: without it
# 200 000 points are drawn two to three times as fast.
_SHARP = """
(() => {
  const get = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, options) {
    const sharp = /webgl/.test(kind) ? { ...(options || {}), antialias: false } : options;
    return get.call(this, kind, sharp);
  };
})();
"""

# While the view moves, as many points as are drawn in time; all once it rests. How long they take
# is measured by a fence, so a GPU always draws all. Points come in random order: any part of a
# cloud is the whole of it, thinner.
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


def drawn_fast(page: str) -> str:
    """A page of viser's that draws many points faster."""
    head, start, tail = page.partition("<head>")
    added = f"<script>{_SHARP}{_THINNED}</script>"
    return f"{head}{start}{added}{tail}" if start else page


def draw_fast(server: Any) -> None:
    """Let the pages of a server of viser's thin what moves, where its version can be told to."""
    with suppress(ImportError, AttributeError):
        from viser._messages import RunJavascriptMessage

        server.gui._websock_interface.queue_message(RunJavascriptMessage(source=_THINNED))
