"""Common style of all pictures: colours, ground plans, scale bars; drawn without a window."""

from __future__ import annotations

import io
import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import requires
from ...geometry import PATH_BREAK_M

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection
    from matplotlib.figure import Figure

GREEN, RED, ORANGE, BLUE = "#12a150", "#e5243b", "#f0883e", "#2e62d6"
"""Correct; false; query or rejected; truth."""
DARK, PATH, GREY, PALE = "#3f4756", "#7d8aa0", "#c3c9d4", "#e6e9ef"
"""Text; trajectories and axes; map; background."""
PALETTE = (
    "#3b7dd8", "#e0702b", "#2a9d5c", "#c43d5d", "#8a63c9",
    "#b08d1f", "#1fa3a8", "#d65fb2", "#7d8794", "#6b8e23",
)  # fmt: skip
"""Colours of series."""
VIOLET, MAGENTA = PALETTE[4], PALETTE[7]
"""Runner-up, or lost; trajectory on a map coloured by height."""
HEIGHTS = ("#41449c", "#3f86c8", "#5fbcc6", "#d8c98a")
"""Ramp of heights, low to high; on white and on black, and none of the colours of outcomes."""
TITLE_PT, TEXT_PT, SMALL_PT = 13.0, 9.0, 8.0

_CELLS_ALONG = 1600
_GOLDEN = 0.381966


def rgb(colour: str) -> tuple[int, int, int]:
    """Convert a colour to three numbers from 0 to 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def by_height(z: Any) -> NDArray[np.uint8]:
    """Return the colour of each height, (N, 3); the ramp spans the middle 96 %."""
    low, high = np.percentile(z, [2, 98])
    at = (len(HEIGHTS) - 1) * ((z - low) / max(float(high - low), 1e-6)).clip(0.0, 1.0)
    stops = np.array([rgb(colour) for colour in HEIGHTS], np.float64).T
    ramp = [np.interp(at, range(len(HEIGHTS)), channel) for channel in stops]
    return np.stack(ramp, axis=1).astype(np.uint8)


def round_length(limit_m: float) -> int:
    """Return the longest round length of a scale bar below a limit [m], at least 1."""
    if limit_m < 1:
        return 1
    power = int(10.0 ** math.floor(math.log10(limit_m)))
    return power * max(step for step in (1, 2, 5) if step * power <= limit_m)


def hue(k: int) -> float:
    """Return the hue of the k-th item, in [0, 1), distinct from those before."""
    return (_GOLDEN * k) % 1.0


def blank(size_in: tuple[float, float], dpi: int, **options: Any) -> Figure:
    """Create an empty white figure [inches]; ``options`` are passed to matplotlib's ``Figure``.

    Raises
    ------
    MissingDependency
        If matplotlib is not installed.
    """
    with requires("matplotlib", "report", "drawing"):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    figure = Figure(figsize=size_in, dpi=dpi, facecolor="white", **options)
    FigureCanvasAgg(figure)
    return figure


def png(figure: Figure, description: str = "") -> bytes:
    """Return a reproducible PNG image with a description in its metadata."""
    image, metadata = io.BytesIO(), {"Description": description} if description else {}
    figure.savefig(image, format="png", metadata={"Software": None, **metadata})
    return image.getvalue()


def plan(axes: Axes, low: Any, high: Any) -> None:
    """Set up axes as a ground plan without a frame, from corner to corner [m]."""
    axes.set_axis_off()
    axes.set_aspect("equal")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])


def coordinates(axes: Axes, names: tuple[str, str] = ("x, m", "y, m")) -> None:
    """Give a ground plan a grid of round coordinates, and names with units.

    Lines are as far apart as the bar of :func:`scale` is long.
    """
    from matplotlib.ticker import MultipleLocator, StrMethodFormatter

    step = float(_bar_m(axes))
    axes.set_axis_on()
    for axis, name in zip((axes.xaxis, axes.yaxis), names, strict=True):
        axis.set_major_locator(MultipleLocator(step))
        axis.set_major_formatter(StrMethodFormatter("{x:.0f}"))
        axis.set_label_text(name, fontsize=TEXT_PT, color=DARK)
    axes.tick_params(labelsize=SMALL_PT, colors=DARK, length=0)
    axes.grid(True, color=PATH, lw=0.5, alpha=0.25)
    for spine in axes.spines.values():
        spine.set_color(PALE)


def _bar_m(axes: Axes) -> int:
    """Return the length of the scale bar of a ground plan [m]."""
    left, right = axes.get_xlim()
    return round_length((right - left) / 5)


def chart(axes: Axes, xlabel: str = "", ylabel: str = "") -> None:
    """Set up axes of a plain chart."""
    axes.spines[["top", "right"]].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(PATH)
    axes.tick_params(labelsize=SMALL_PT, colors=DARK, length=2)
    axes.grid(True, color=PALE, lw=0.8)
    axes.set_axisbelow(True)
    axes.set_xlabel(xlabel, fontsize=TEXT_PT, color=DARK)
    axes.set_ylabel(ylabel, fontsize=TEXT_PT, color=DARK)


def title(figure: Figure, text: str, y: float = 0.975) -> None:
    """Add a heading at the upper left."""
    made = figure.text(0.02, y, text, fontsize=TITLE_PT, fontweight="bold", color=DARK, va="center")
    made.set_parse_math(False)  # names may hold $


def legend(axes: Axes, **place: Any) -> None:
    """Add a legend, by default at the upper right."""
    made = axes.legend(
        **{"loc": "upper right", "borderpad": 0.8, **place},
        frameon=True, framealpha=0.9, edgecolor="none", fontsize=TEXT_PT, labelcolor=DARK,
    )  # fmt: skip
    for text in made.get_texts():
        text.set_parse_math(False)


def dots(axes: Axes, points: Any, **style: Any) -> PathCollection:
    """Draw points (N, 2 or more) from above."""
    return axes.scatter(points[:, 0], points[:, 1], **{"linewidths": 0, **style})


def draw_path(axes: Axes, path: Any, **style: Any) -> None:
    """Draw a path (N, 2) from above, with gaps where it jumps; nothing if it is empty."""
    if not len(path):
        return
    jumps = np.flatnonzero(np.linalg.norm(np.diff(path, axis=0), axis=1) > PATH_BREAK_M) + 1
    axes.plot(*np.insert(path, jumps, np.nan, axis=0).T, lw=1.2, zorder=1, **style)


def density(axes: Axes, points: Any, low: Any, high: Any) -> None:
    """Draw the density of points from above as one grey image."""
    if not len(points):
        return
    cell = max(0.3, float((high - low).max()) / _CELLS_ALONG)
    shape = np.maximum(((high - low) / cell).astype(int), 1)
    edges = np.stack([low, high], axis=1)
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=shape, range=edges)
    shade = np.log1p(counts)
    shade /= max(float(np.percentile(shade[shade > 0], 97)), 1e-9) if shade.any() else 1.0
    axes.imshow(
        shade.T,
        origin="lower",
        extent=(low[0], high[0], low[1], high[1]),
        cmap="Greys",
        vmin=0.0,
        vmax=1.6,
        interpolation="antialiased",
        zorder=0,
    )


def scale(axes: Axes) -> None:
    """Draw a scale bar of a round length at the lower left of a ground plan."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    length = _bar_m(axes)
    margin = 0.02 * max(right - left, high - low)
    x, y = left + margin, low + margin
    axes.plot([x, x + length], [y, y], color=DARK, lw=2.5, solid_capstyle="butt", zorder=9)
    axes.annotate(
        f"{length} m",
        (x + length / 2, y),
        xytext=(0, 4),
        textcoords="offset points",
        ha="center",
        fontsize=TEXT_PT,
        color=DARK,
        zorder=9,
    )
