"""Pictures without a window: an empty one, and the bytes of a finished one."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

from .errors import MissingDependency

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def blank(size_in: tuple[float, float], dpi: int, **options: Any) -> Figure:
    """An empty white picture of so many inches; ``options`` are those of matplotlib's ``Figure``.

    Raises
    ------
    MissingDependency
        If matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingDependency("matplotlib", "report", "drawing") from error
    figure = Figure(figsize=size_in, dpi=dpi, facecolor="white", **options)
    FigureCanvasAgg(figure)
    return figure


def png(figure: Figure) -> bytes:
    """A PNG image, the same for the same picture."""
    image = io.BytesIO()
    figure.savefig(image, format="png", metadata={"Software": None})
    return image.getvalue()
