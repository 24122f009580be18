"""Export formats, their sources and writers."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ConfigError, DatasetError, InvalidScan, SeglocError
from ...geometry import cells_of
from ...map.segment_map import SegmentMap
from ...motion import odometry_covariance
from ...system.checks import checked_pose
from ...system.files import checked_target, make_folder, write_bytes, write_text
from ...types import Float32, Float64, Int64
from ..io.g2o import PoseEdges, format_g2o
from ..io.las import format_laz
from ..io.pcd import format_pcd
from ..io.ply import format_ply
from .nav2 import GridOptions, write_nav2
from .sources import AlignedSource, FoundSource, MapSource, open_source
from .tracks import Place, write_geojson, write_tum_files

_ANY = (MapSource, FoundSource, AlignedSource)
FLOAT32_M = 16_384.0
"""Distance from the origin beyond which float32 is coarser than a millimetre."""
AUTOWARE_FOLDER, AUTOWARE_METADATA = "pointcloud_map.pcd", "pointcloud_map_metadata.yaml"


@dataclass(frozen=True)
class Options:
    """Options of single formats."""

    tile_m: float = 20.0  # edge of Autoware's tiles [m]
    epsg: int | None = None  # frame named in GeoJSON
    place: Place | None = None  # place of the map's origin on the globe, for GeoJSON
    grid: GridOptions = field(default_factory=GridOptions)  # for Nav2
    in_cloud: bool = False  # poses in the frame of the cloud that was levelled, TUM and GeoJSON


@dataclass(frozen=True)
class Format:
    """An export format."""

    of: tuple[type, ...]  # types of sources it accepts
    text: str  # description
    # writes a source to a path with options; returns notes
    write: Callable[[Any, Path, Options], list[str]]
    suffixes: tuple[str, ...] = ()  # of the output; none: it is a folder

    @property
    def requirement(self) -> str:
        return " or ".join(kind.what for kind in self.of)  # type: ignore[attr-defined]


FORMATS = {
    "pcd": Format(
        (MapSource,),
        "the map's cloud, for PCL",
        lambda s, out, _: _write(s.prior_map, out, format_pcd),
        (".pcd",),
    ),
    "ply": Format(
        (MapSource,),
        "the map's cloud, for viewers",
        lambda s, out, _: _write(s.prior_map, out, format_ply),
        (".ply",),
    ),
    "laz": Format(
        (MapSource,),
        "the map's cloud, for GIS",
        lambda s, out, _: write_laz(s.prior_map, out),
        (".laz",),
    ),
    "autoware": Format(
        (MapSource,),
        "the map's cloud in PCD tiles with their metadata",
        lambda s, out, o: write_autoware(s.prior_map, out, o.tile_m),
    ),
    "nav2": Format(
        (MapSource,),
        "occupancy grids, map.pgm and map.yaml",
        lambda s, out, o: write_nav2(s.prior_map, out, o.grid),
    ),
    "g2o": Format(
        (AlignedSource,),
        "poses, odometry and loops",
        lambda s, out, _: write_g2o(s, out),
        (".g2o",),
    ),
    "loops": Format(
        (AlignedSource,),
        "accepted loops, JSON lines",
        lambda s, out, _: write_loops(s, out),
        (".jsonl", ".json"),
    ),
    "tum": Format(
        _ANY,
        "poses by time",
        lambda s, out, o: write_tum_files(s, out, o.in_cloud),
        (".tum", ".txt"),
    ),
    "geojson": Format(
        _ANY,
        "drives as lines, poses found and viewpoints as points",
        lambda s, out, o: write_geojson(s, out, o.epsg, o.place, o.in_cloud),
        (".geojson", ".json"),
    ),
}


_IN_CLOUD = ("tum", "geojson")


def export(path: str | Path, to: str, out: str | Path, options: Options | None = None) -> list[str]:
    """Export a map or results to another format.

    Parameters
    ----------
    path : path
        A map, or the output folder of `segloc localize`, `live` or `align`.
    to : str
        One of :data:`FORMATS`.
    out : path
        File or, for Autoware, Nav2 and several sessions, folder to write.
    options : Options, optional

    Returns
    -------
    list of str
        Notes for the user, one line each.

    Raises
    ------
    ConfigError
        If the format is unknown, or does not accept this source.
    SeglocError
        If the source cannot be read or the output cannot be written.
    """
    form = FORMATS.get(to)
    if form is None:
        raise ConfigError(f"--to {to}: unknown format; supported: {', '.join(FORMATS)}")
    if options is not None and options.in_cloud and to not in _IN_CLOUD:
        raise ConfigError(f"--cloud-frame is for {' and '.join(_IN_CLOUD)}, not for {to}")
    source = open_source(Path(path))
    if not isinstance(source, form.of):
        raise ConfigError(f"{path}: --to {to} needs {form.requirement}, and this is {source.what}")
    target = Path(out)
    if form.suffixes and not (to == "tum" and isinstance(source, AlignedSource)):
        checked_target(target, *form.suffixes)
    return form.write(source, target, options or Options())


def write_laz(prior_map: SegmentMap, out: Path) -> list[str]:
    """Write LAZ with a resolution of 1 mm."""
    write_bytes(out, format_laz(_points(prior_map), offset=np.round(prior_map.origin)))
    return []


def write_autoware(prior_map: SegmentMap, out: Path, tile_m: float) -> list[str]:
    """Write the folder of Autoware's map loader: square tiles along x and y, and their list.

    Each tile is named by its lower corner, a multiple of ``tile_m``.
    """
    points, notes = _near_origin(prior_map)
    folder = out / AUTOWARE_FOLDER
    make_folder(folder)
    if leftover := next(folder.iterdir(), None):
        raise SeglocError(f"{folder}: contains {leftover.name}: choose a new folder")
    corners = cells_of(points[:, :2].astype(np.float64), tile_m)
    order = np.lexsort((corners[:, 0], corners[:, 1]))
    starts = np.flatnonzero(np.diff(corners[order], axis=0, prepend=np.nan).any(axis=1))
    lines = [f"x_resolution: {tile_m:g}\n", f"y_resolution: {tile_m:g}\n"]
    for rows in np.split(order, starts[1:]):
        x, y = (float(v) * tile_m for v in corners[rows[0]])
        name = f"{x:g}_{y:g}.pcd"
        write_bytes(folder / name, format_pcd(points[rows]), sweep=False)
        lines.append(f"{name}: [{x:g}, {y:g}]\n")
    write_text(out / AUTOWARE_METADATA, "".join(lines))
    return notes


def _write(prior_map: SegmentMap, out: Path, form: Callable[[Float32], bytes]) -> list[str]:
    points, notes = _near_origin(prior_map)
    write_bytes(out, form(points))
    return notes


def _points(prior_map: SegmentMap) -> Float64:
    if not len(prior_map.cloud):
        raise SeglocError("nothing to export: the map has no cloud")
    return prior_map.cloud.astype(np.float64) + prior_map.origin


def _near_origin(prior_map: SegmentMap) -> tuple[Float32, list[str]]:
    """Return points as float32, relative to the map's origin if far from zero."""
    points = _points(prior_map)
    if np.abs(points).max() <= FLOAT32_M:
        return points.astype(np.float32), []
    origin = np.round(prior_map.origin)
    x, y, z = (f"{value:.0f}" for value in origin)
    note = f"coordinates are shifted by -({x}, {y}, {z}): too large for float32"
    return (points - origin).astype(np.float32), [note]


def write_loops(source: AlignedSource, out: Path) -> list[str]:
    """Write the accepted loops, one JSON object per line."""
    lines = [json.dumps(loop, allow_nan=False) + "\n" for loop in _accepted_loops(source)]
    write_text(out, "".join(lines))
    return []


def write_g2o(source: AlignedSource, out: Path) -> list[str]:
    """Write all scans as vertices, odometry and accepted loops as edges.

    Vertices are numbered over all sessions; the first of each component is fixed.
    """
    sessions = range(len(source.names))
    tracks = [source.session(k) for k in sessions]
    first = np.concatenate([[0], np.cumsum([len(track) for track in tracks])]).astype(np.int64)
    edges = [_odometry(source, k, int(first[k])) for k in sessions]
    edges.append(_loops(source, [track.stamps for track in tracks], first))
    fixed = [int(first[members[0]]) for members in source.components]
    poses = np.concatenate([track.poses for track in tracks])
    write_text(out, format_g2o(poses, edges, fixed))
    return []


def _accepted_loops(source: AlignedSource) -> list[dict[str, Any]]:
    return [loop for loop in source.loops() if loop.get("accepted") is True]


def _odometry(source: AlignedSource, session: int, first: int) -> PoseEdges:
    """Return the edges between consecutive scans."""
    poses = source.odometry(session).poses
    numbers = np.arange(first, first + len(poses) - 1, dtype=np.int64)
    T = np.linalg.inv(poses[:-1]) @ poses[1:]
    length = np.linalg.norm(T[:, :3, 3], axis=1)
    return PoseEdges(numbers, numbers + 1, T, odometry_covariance(length, *source.noise))


def _loops(source: AlignedSource, numbers: list[Float64], first: Int64) -> PoseEdges:
    found = _accepted_loops(source)
    ends = {"target": np.empty(len(found), np.int64), "source": np.empty(len(found), np.int64)}
    T, covariance = np.empty((len(found), 4, 4)), np.empty((len(found), 6, 6))
    for n, loop in enumerate(found):
        try:
            for end, rows in ends.items():
                k, scan = int(loop[f"{end}_session"]), float(loop[f"{end}_scan"])
                rows[n] = first[k] + np.flatnonzero(numbers[k] == scan)[0]
            T[n] = checked_pose(loop["T_target_source"], "T_target_source")
            covariance[n] = loop["covariance"]
        except (KeyError, IndexError, TypeError, ValueError, InvalidScan) as error:
            raise DatasetError(
                f"{source.path}/loops.jsonl: accepted loop {n + 1} belongs to no session"
            ) from error
    return PoseEdges(ends["target"], ends["source"], T, covariance)
