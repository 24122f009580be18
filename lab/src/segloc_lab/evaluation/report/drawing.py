"""Figures as SVG that takes the colour of its text from the page."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from segloc.errors import MissingDependency
from segloc.inspect.pictures import GREEN, ORANGE, PALETTE, PATH, RED, rgb
from segloc.types import Float64

from .study import Curve, Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_INK = "#010203"
"""Stands for the page's own text colour until the figure is drawn."""

_METADATA = re.compile(r"<metadata>.*?</metadata>", re.DOTALL)
_PROLOG = re.compile(r"^.*?(?=<svg)", re.DOTALL)
_ID = re.compile(r' id="([^"]*)"')
_REFERENCE = re.compile(r'(?:url\(|href=")#([^")]+)[")]')
_CELLS_ALONG = 900


@dataclass(frozen=True)
class MapStyle:
    """How one kind of thing is drawn on a map: as a cloud, a line or dots."""

    kind: str
    colour: str
    hollow: bool = False
    layer: int = 1
    width: float = 1.2


MAP_STYLES: Mapping[str, MapStyle] = {
    "map": MapStyle("cloud", PATH, layer=0),
    "query": MapStyle("cloud", ORANGE, layer=1),
    "path of the map": MapStyle("line", PATH),
    "other matches": MapStyle("line", RED, layer=2, width=0.4),
    "matches that fit": MapStyle("line", GREEN, layer=3, width=0.4),
    "not localized": MapStyle("dots", _INK, hollow=True, layer=2),
    "true place of a false one": MapStyle("line", RED, layer=3),
    "localized": MapStyle("dots", GREEN, layer=4),
    "localized falsely": MapStyle("dots", RED, layer=5),
}
"""By the label of a series; any other is a line."""


def svg(figure: Figure, prefix: str = "") -> str:
    """Draw a figure.

    Parameters
    ----------
    figure : Figure
    prefix : str
        Of the ids inside, which must differ from those of other drawings in a page.

    Returns
    -------
    str
        An ``<svg>`` element that can stand in a page among others; the same for the same figure.

    Raises
    ------
    MissingDependency
        If matplotlib is not installed.
    """
    try:
        import matplotlib
        from matplotlib.backends.backend_svg import FigureCanvasSVG
        from matplotlib.figure import Figure as Canvas
    except ImportError as error:
        raise MissingDependency("matplotlib", "report", "drawing") from error
    with matplotlib.rc_context(_settings()):
        canvas = Canvas(figsize=_size(figure), layout="constrained", facecolor="none")
        FigureCanvasSVG(canvas)
        axes = canvas.add_subplot(projection="polar" if figure.kind == "polar" else None)
        axes.set_facecolor("none")
        _DRAW[figure.kind](axes, figure)
        stream = io.StringIO()
        untold = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        canvas.savefig(
            stream, format="svg", dpi=110, metadata=untold, bbox_inches="tight", pad_inches=0.04
        )
    text = _PROLOG.sub("", _METADATA.sub("", stream.getvalue()))
    text = _renamed(text, f"{prefix}{figure.name}")
    return text.replace(_INK, "currentColor").replace("<svg", '<svg role="img"', 1)


def _renamed(text: str, prefix: str) -> str:
    """With ids that are of use to the drawing alone, and begin with the prefix."""
    used = set(_REFERENCE.findall(text))
    text = _ID.sub(lambda m: f' id="{prefix}-{m[1]}"' if m[1] in used else "", text)
    return _REFERENCE.sub(lambda m: m[0].replace(f"#{m[1]}", f"#{prefix}-{m[1]}"), text)


def _settings() -> dict[str, Any]:
    inks = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")
    return {
        **dict.fromkeys(inks, _INK),
        "svg.fonttype": "none",
        "svg.hashsalt": "segloc",  # ids come from it instead of from chance
        "font.size": 10.0,
        "axes.linewidth": 0.6,
        "grid.color": PATH,
        "grid.alpha": 0.35,
        "grid.linewidth": 0.5,
        "legend.frameon": False,
        "legend.fontsize": 8.5,
    }


def _size(figure: Figure) -> tuple[float, float]:
    if figure.kind == "map":
        low, high = _extent(figure)
        wide, tall = high - low
        return 6.4, float(np.clip(6.4 * tall / wide, 2.4, 7.5)) + 0.5
    return {"roc": (4.6, 4.6), "polar": (4.8, 4.8)}.get(figure.kind, (6.4, 3.9))


def _curves(axes: Axes, figure: Figure) -> None:
    few = max((len(x) for x, _ in figure.series.values()), default=0) <= 20
    for k, (label, (x, y)) in enumerate(figure.series.items()):
        axes.plot(x, y, color=_colour(k), lw=1.6, label=label, marker="o" if few else "", ms=3.5)
    axes.grid(True)
    axes.set_xlabel(figure.xlabel)
    axes.set_ylabel(figure.ylabel)
    _legend(axes)


def _roc(axes: Axes, figure: Figure) -> None:
    axes.plot([0, 1], [0, 1], color=PATH, lw=0.8, ls=":")
    for k, (label, (x, y)) in enumerate(figure.series.items()):
        axes.plot(x, y, color=_colour(k), lw=1.5, label=label)
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1.005)
    axes.set_aspect("equal")
    axes.grid(True)
    axes.set_xlabel(figure.xlabel or "false positive rate")
    axes.set_ylabel(figure.ylabel or "true positive rate")
    _legend(axes, loc="lower right")


def _polar(axes: Axes, figure: Figure) -> None:
    for k, (label, (degrees, radius)) in enumerate(figure.series.items()):
        axes.plot(np.radians(degrees), radius, color=_colour(k), lw=1.5, label=label)
    axes.set_ylim(bottom=0, top=figure.top)
    axes.grid(True)
    _legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.06), ncol=2)


def _bars(axes: Axes, figure: Figure) -> None:
    width = 0.8 / max(1, len(figure.series))
    for k, (label, (x, y)) in enumerate(figure.series.items()):
        shift = (k - (len(figure.series) - 1) / 2) * width
        axes.bar(x + shift, y, width=0.92 * width, color=_colour(k), label=label)
    axes.grid(True, axis="y")
    axes.set_axisbelow(True)
    axes.set_xlabel(figure.xlabel)
    axes.set_ylabel(figure.ylabel)
    _legend(axes)


def _map(axes: Axes, figure: Figure) -> None:
    low, high = _extent(figure)
    for k, (label, (x, y)) in enumerate(figure.series.items()):
        style = MAP_STYLES.get(label, MapStyle("line", _colour(k)))
        if style.kind == "cloud":
            _cloud(axes, (x, y), style, (low, high))
        elif style.kind == "line":
            name = label if len(x) else None
            axes.plot(x, y, color=style.colour, lw=style.width, label=name, zorder=style.layer)
        else:
            axes.scatter(
                x,
                y,
                s=20,
                facecolors="none" if style.hollow else style.colour,
                edgecolors=style.colour,
                linewidths=0.9 if style.hollow else 0.0,
                label=f"{label} ({len(x)})",
                zorder=style.layer,
            )
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.tick_params(length=2)
    axes.set_xlabel(figure.xlabel)
    axes.set_ylabel(figure.ylabel)
    _legend(axes, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=3)


def _cloud(axes: Axes, points: Curve, style: MapStyle, extent: tuple[Float64, Float64]) -> None:
    """Coloured where there is anything: one picture, however many points there are."""
    (x, y), (low, high) = points, extent
    cell = max(0.5, float((high - low).max()) / _CELLS_ALONG)
    shape = np.maximum(np.ceil((high - low) / cell).astype(int), 1)
    counts, _, _ = np.histogram2d(x, y, bins=shape, range=np.stack([low, low + shape * cell]).T)
    picture = np.zeros((*counts.T.shape, 4))
    picture[..., :3] = [part / 255 for part in rgb(style.colour)]
    picture[..., 3] = 0.6 * (counts.T > 0)
    end = low + shape * cell
    box = (low[0], end[0], low[1], end[1])
    axes.imshow(picture, origin="lower", extent=box, interpolation="nearest", zorder=style.layer)


def _extent(figure: Figure) -> tuple[Float64, Float64]:
    curves = [np.column_stack(curve) for curve in figure.series.values()]
    points = np.concatenate([np.empty((0, 2)), *curves])
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        points = np.zeros((1, 2))
    return points.min(axis=0) - 5.0, points.max(axis=0) + 5.0


def _legend(axes: Axes, **place: Any) -> None:
    """At its place, or wherever there is room; none for a single curve without one."""
    count = len(axes.get_legend_handles_labels()[0])
    if count > 6 and not place:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    elif count > (0 if place else 1):
        axes.legend(**(place or {"loc": "best"}))


def _colour(k: int) -> str:
    return PALETTE[k % len(PALETTE)]


_DRAW = {"roc": _roc, "polar": _polar, "bars": _bars, "map": _map, "lines": _curves}
