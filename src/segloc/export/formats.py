"""Which formats there are, and of what each can be made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import ConfigError
from ..system.files import checked_target
from .clouds import write_autoware, write_laz, write_pcd, write_ply
from .graphs import write_g2o, write_loops
from .sources import AlignedSource, FoundSource, MapSource, opened
from .tracks import Place, write_geojson, write_tum_files

_ANY = (MapSource, FoundSource, AlignedSource)


@dataclass(frozen=True)
class Options:
    """What single formats can be told.

    Attributes
    ----------
    tile_m : float
        Edge of Autoware's tiles, metres.
    epsg : int or None
        Frame that GeoJSON names.
    place : Place or None
        Where the map's origin lies on the globe, for GeoJSON.
    """

    tile_m: float = 20.0
    epsg: int | None = None
    place: Place | None = None


@dataclass(frozen=True)
class Format:
    """A format of others.

    Attributes
    ----------
    of : tuple of type
        The sources that it can be made of.
    text : str
        What is written, for people.
    write : callable
        Writes a source to a path by options; gives what is to be noted.
    folder : bool
        Whether it is a folder rather than a file.
    """

    of: tuple[type, ...]
    text: str
    write: Callable[[Any, Path, Options], list[str]]
    folder: bool = False

    @property
    def needs(self) -> str:
        return " or ".join(kind.what for kind in self.of)  # type: ignore[attr-defined]


FORMATS = {
    "pcd": Format(
        (MapSource,), "the map's cloud, for PCL", lambda s, out, _: write_pcd(s.prior_map, out)
    ),
    "ply": Format(
        (MapSource,), "the map's cloud, for viewers", lambda s, out, _: write_ply(s.prior_map, out)
    ),
    "laz": Format(
        (MapSource,), "the map's cloud, for GIS", lambda s, out, _: write_laz(s.prior_map, out)
    ),
    "autoware": Format(
        (MapSource,),
        "the map's cloud in PCD tiles with their metadata",
        lambda s, out, o: write_autoware(s.prior_map, out, o.tile_m),
        folder=True,
    ),
    "g2o": Format(
        (AlignedSource,), "poses, odometry and loops", lambda s, out, _: write_g2o(s, out)
    ),
    "loops": Format(
        (AlignedSource,), "accepted loops, JSON lines", lambda s, out, _: write_loops(s, out)
    ),
    "tum": Format(_ANY, "poses by time", lambda s, out, _: write_tum_files(s, out)),
    "geojson": Format(
        _ANY, "paths as lines", lambda s, out, o: write_geojson(s, out, o.epsg, o.place)
    ),
}


def export(path: str | Path, to: str, out: str | Path, options: Options | None = None) -> list[str]:
    """Write a map or results in a format of others.

    Parameters
    ----------
    path : path
        A map, or the folder that `segloc localize`, `live` or `align` wrote.
    to : str
        One of :data:`FORMATS`.
    out : path
        The file, or for Autoware the folder, to write.
    options : Options, optional

    Returns
    -------
    list of str
        What the user should know of it, a line each.

    Raises
    ------
    ConfigError
        If there is no such format, or it cannot be made of that.
    SeglocError
        If it cannot be read or written.
    """
    form = FORMATS.get(to)
    if form is None:
        raise ConfigError(f"--to {to}: there is {', '.join(FORMATS)}")
    source = opened(Path(path))
    if not isinstance(source, form.of):
        raise ConfigError(f"{path}: --to {to} needs {form.needs}, and this is {source.what}")
    target = Path(out)
    if not form.folder and not (to == "tum" and isinstance(source, AlignedSource)):
        checked_target(target)
    return form.write(source, target, options or Options())
