"""How many frames a second `segloc view` draws with so many points in view, in software.

python -m segloc_lab.bench.view_rate [--points 200000] [--bare]

A map of random points is drawn in a headless Chromium that renders on the processor, and the view
is dragged with the mouse. On a busy machine the frames a second of processor time tell more, and
the ratio to a bare page: as many points by the simplest shaders, and nothing else (`--bare`).
"""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from segloc.inspect.viewer import html
from segloc.map.segment_map import SegmentMap
from segloc.types import Descriptors

from ..script import parser
from .browser import browser

SEED, SIDE_M = 0, 120.0
_BARE = """<!doctype html><canvas width=1000 height=700></canvas><script>
const n = COUNT, g = document.querySelector("canvas").getContext("webgl2", { antialias: false });
const program = g.createProgram();
const add = (kind, source) => {
  const shader = g.createShader(kind);
  g.shaderSource(shader, "#version 300 es\\nprecision mediump float;" + source);
  g.compileShader(shader);
  g.attachShader(program, shader);
};
add(g.VERTEX_SHADER, `in vec3 p; uniform float t; out vec3 c; void main() {
  vec2 q = mat2(cos(t), sin(t), -sin(t), cos(t)) * p.xy;
  float away = 75. - .6 * q.y - .8 * p.z;
  c = vec3(.4 + .1 * p.z);
  gl_Position = vec4(1.1 * q.x, 1.57 * (.8 * q.y - .6 * p.z), away - .1, away);
  gl_PointSize = 108. / away;
}`);
add(g.FRAGMENT_SHADER, "in vec3 c; out vec4 o; void main() { o = vec4(c, 1.); }");
g.linkProgram(program);
g.useProgram(program);
g.enable(g.DEPTH_TEST);
const box = [120, 120, 6], low = [-60, -60, 0];
const place = (_, i) => box[i % 3] * Math.random() + low[i % 3];
const points = Float32Array.from({ length: 3 * n }, place);
g.bindBuffer(g.ARRAY_BUFFER, g.createBuffer());
g.bufferData(g.ARRAY_BUFFER, points, g.STATIC_DRAW);
g.enableVertexAttribArray(0);
g.vertexAttribPointer(0, 3, g.FLOAT, false, 0, 0);
let frame = 0;
const draw = () => {
  g.clear(g.COLOR_BUFFER_BIT | g.DEPTH_BUFFER_BIT);
  g.uniform1f(g.getUniformLocation(program, "t"), 0.01 * frame++);
  g.drawArrays(g.POINTS, 0, n);
  requestAnimationFrame(draw);
};
draw();
</script>"""


def page(points: int) -> str:
    """The page of a map of so many points."""
    rng = np.random.default_rng(SEED)
    cloud = rng.uniform(-SIDE_M / 2, SIDE_M / 2, (points, 3)).astype(np.float32)
    cloud[:, 2] = np.abs(cloud[:, 2]) / 10.0
    return html(_map(cloud), [])


def _map(cloud: np.ndarray) -> SegmentMap:
    made = SegmentMap.empty("geo", "0" * 16, 7, cloud_voxel=0.01)
    nothing = Descriptors(np.zeros((0, 7), np.float32), None)
    made.add(nothing, np.zeros((0, 3)), np.zeros(0, np.int64), session=0, stamp=0.0, cloud=cloud)
    made.add_trajectory(np.eye(4)[None])
    return made


def bare_page(points: int) -> str:
    """Points that turn, drawn by nothing but WebGL."""
    return _BARE.replace("COUNT", str(points))


def measured(points: int, seconds: float, bare: bool = False) -> dict[str, Any]:
    """Frames a second, of wall time and of the browser's processor time."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "page.html"
        file.write_text(bare_page(points) if bare else page(points), "utf-8")
        with browser(Path(folder) / "profile") as shown:
            shown.open(file.as_uri())
            if not shown.until("window.framesDrawn > 3", 120.0):
                raise SystemExit("nothing is drawn")
            return {"points": points, **shown.frame_rate(seconds), "faults": shown.faults}


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--points", type=int, default=200_000)
    options.add_argument("--seconds", type=float, default=10.0)
    options.add_argument("--bare", action="store_true", help="the bare page in place of segloc's")
    given = options.parse_args()
    print(json.dumps(measured(given.points, given.seconds, given.bare), indent=2))


if __name__ == "__main__":
    main()
