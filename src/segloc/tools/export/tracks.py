"""Trajectories and poses as TUM files and as GeoJSON."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from ... import geometry
from ...errors import ConfigError, SeglocError
from ...geometry import PATH_BREAK_M, ros_covariance
from ...map.georeference import Georeference
from ...system.files import make_folder, write_text
from ...system.text import quantity
from ...types import Float64, Pose
from ..io import Trajectory, write_tum
from .sources import AlignedSource, FoundSource, MapSource, Source

UNTIMED = "no times: the first column is the scan number"
_DEGREE_DIGITS = 8
_UNIX_S = (1e9, 4e9)  # seconds since 1970, of 2001 to 2096
_FAR_M = 1e5  # of a map from its origin
_EQUATOR_M, _FLATTENING = 6378137.0, 1.0 / 298.257223563  # WGS 84


@dataclass(frozen=True)
class Place:
    """Place of a map's origin on the globe; its x axis points east."""

    latitude: float  # degrees, WGS 84
    longitude: float

    @classmethod
    def parse(cls, text: str) -> Place:
        """Parse ``LATITUDE,LONGITUDE``; raise ConfigError if the text is invalid."""
        try:
            latitude, longitude = (float(part) for part in text.split(","))
        except ValueError as error:
            raise ConfigError(
                f"--at {text[:40]!r}: expects LATITUDE,LONGITUDE in degrees"
            ) from error
        if not (abs(latitude) < 89.9 and abs(longitude) <= 180.0):
            raise ConfigError(f"--at {text[:40]!r}: outside the globe, or at a pole")
        return cls(latitude, longitude)

    def degrees(self, xy: Float64) -> Float64:
        """Convert (N, 2) metres to longitude, latitude; accurate to 1 cm within some kilometres."""
        if len(xy) and np.abs(xy).max() > _FAR_M:
            raise ConfigError(
                f"--at is the map's origin, from which it lies {np.abs(xy).max() / 1e3:.0f} km: "
                "build a map in projected coordinates with --epsg"
            )
        phi = math.radians(self.latitude)
        squared = _FLATTENING * (2.0 - _FLATTENING)
        bent = 1.0 - squared * math.sin(phi) ** 2
        north = _EQUATOR_M * (1.0 - squared) / bent**1.5
        east = _EQUATOR_M / math.sqrt(bent) * math.cos(phi)
        steps = np.degrees(xy / np.array([east, north]))
        return np.asarray(steps + [self.longitude, self.latitude], dtype=np.float64)


def tracks(source: Source, in_cloud: bool = False) -> Iterator[tuple[str, Trajectory, str]]:
    """Yield name, trajectory, and a remark on its stamps, of each session.

    Poses are in the frame of the map or, with ``in_cloud``, of the cloud that was levelled.
    """
    if isinstance(source, AlignedSource):
        if in_cloud:
            raise ConfigError("--cloud-frame needs a map, or results in one")
        for k, name in enumerate(source.names):
            yield name, source.session(k), UNTIMED
    elif isinstance(source, MapSource):
        poses = _in_frame(source, source.prior_map.trajectory, in_cloud)
        if not len(poses):
            raise SeglocError(f"{source.path}: the map has no sensor trajectory")
        numbers = np.arange(len(poses), dtype=np.float64)
        yield source.path.stem, Trajectory(numbers, poses), "a map's poses have no times: numbered"
    else:
        if not len(source.track):
            raise SeglocError(f"{source.path}: no trajectory: no query was localized")
        poses = _in_frame(source, source.track.poses, in_cloud)
        track = Trajectory(source.track.stamps, poses)
        yield source.path.resolve().name, track, "" if source.timed else UNTIMED


def _in_frame(source: MapSource | FoundSource, poses: Float64, in_cloud: bool) -> Float64:
    """Return poses (..., 4, 4) in the frame of the map, or of the cloud that was levelled."""
    of = source.prior_map if isinstance(source, MapSource) else source
    placed: Float64 = geometry.inverse(of.T_map_cloud) @ poses if in_cloud else poses
    return placed


def write_tum_files(source: Source, out: Path, in_cloud: bool = False) -> list[str]:
    """Write one file; for several aligned sessions a folder with one file each."""
    listed = list(tracks(source, in_cloud))
    if not isinstance(source, AlignedSource) or len(listed) == 1:
        write_tum(out, *listed[0][1:])
        return _viewpoints_note(source)
    make_folder(out)
    for k, (_, track, remark) in enumerate(listed):
        write_tum(out / f"session_{k}.tum", track, remark)
    return []


def _viewpoints_note(source: Source) -> list[str]:
    """Tell poses that a sensor had from viewpoints chosen in a cloud or plan."""
    chosen = int((~source.prior_map.is_driven).sum()) if isinstance(source, MapSource) else 0
    if not chosen:
        return []
    return [f"{quantity(chosen, 'viewpoints')} of these poses were chosen in a cloud, not driven"]


def write_geojson(
    source: Source,
    out: Path,
    epsg: int | None = None,
    place: Place | None = None,
    in_cloud: bool = False,
) -> list[str]:
    """Write lines of sessions, and points of viewpoints and of poses found.

    RFC 7946 requires WGS 84. Coordinates are in degrees if the map is georeferenced, or by
    ``place``. Otherwise they are the map's metres, or those of the frame ``epsg``, which is named
    in the member "crs" of GeoJSON 2008 that GDAL and QGIS support.
    """
    if epsg is not None and place is not None:
        raise ConfigError("--epsg and --at exclude each other")
    known = _georeference(source)
    axes = _Axes.of(known, epsg, place)
    document: dict[str, Any] = {"type": "FeatureCollection"}
    if epsg is not None:
        name = f"urn:ogc:def:crs:EPSG::{epsg}"
        document["crs"] = {"type": "name", "properties": {"name": name}}
    document["features"] = list(_features(source, axes, in_cloud))
    write_text(out, json.dumps(document, allow_nan=False) + "\n")
    if epsg is None and place is None and known is None:
        return ["coordinates are the map's metres: --at LAT,LON or --epsg N georeferences them"]
    return []


def _georeference(source: Source) -> Georeference | None:
    """Return the georeference of a map or of the map of results."""
    if isinstance(source, MapSource):
        return Georeference.of(source.prior_map.metadata)
    return source.georeference if isinstance(source, FoundSource) else None


@dataclass(frozen=True)
class _Axes:
    """Conversion of positions in the map (N, 3) to coordinates of GeoJSON."""

    convert: Callable[[Float64], Float64]
    digits: int  # of x and y

    @classmethod
    def of(cls, known: Georeference | None, epsg: int | None, place: Place | None) -> _Axes:
        if place is not None and known is not None:
            raise ConfigError("--at: the map is georeferenced; degrees are written without it")
        if place is not None:
            return cls(
                lambda xyz: np.column_stack([place.degrees(xyz[:, :2]), xyz[:, 2]]), _DEGREE_DIGITS
            )
        if epsg is None:
            return cls(lambda xyz: xyz, 3) if known is None else cls(known.on_globe, _DEGREE_DIGITS)
        if known is None:
            return cls(lambda xyz: xyz, 3)
        if known.epsg != epsg:
            raise ConfigError(
                f"--epsg {epsg}: the map is in EPSG:{known.epsg}; pass that, or neither for degrees"
            )
        return cls(lambda xyz: xyz + np.array(known.origin_m), 3)

    def of_poses(self, poses: Float64) -> list[list[float]]:
        """Return the rounded coordinates of poses (N, 4, 4)."""
        digits = self.digits
        return [
            [round(float(x), digits), round(float(y), digits), round(float(z), 3)]
            for x, y, z in self.convert(poses[:, :3, 3])
        ]


def _features(source: Source, axes: _Axes, in_cloud: bool) -> Iterator[dict[str, Any]]:
    for name, track, _ in tracks(source, in_cloud):
        if isinstance(source, MapSource):
            driven = source.prior_map.is_driven
            if driven.any():
                yield _lines(name, track.poses[driven], axes)
            if not driven.all():
                places = axes.of_poses(track.poses[~driven])
                yield _feature("MultiPoint", places, name=name, viewpoints=len(places))
        elif isinstance(source, AlignedSource) or source.is_drive:
            yield _lines(name, track.poses, axes)
        if isinstance(source, FoundSource):
            for found in source.answers():
                yield _point(name, found, _in_frame(source, found["T"], in_cloud), axes)


def _lines(name: str, poses: Float64, axes: _Axes) -> dict[str, Any]:
    steps = np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1)
    parts = np.split(poses, np.flatnonzero(steps > PATH_BREAK_M) + 1)
    lines = [axes.of_poses(part) for part in parts]
    lines = [line if len(line) > 1 else line * 2 for line in lines]  # a line needs two points
    return _feature("MultiLineString", lines, name=name, poses=len(poses))


def _point(name: str, found: dict[str, Any], T: Pose, axes: _Axes) -> dict[str, Any]:
    """Return the feature of a pose found, with the covariance of ROS."""
    covariance, stamp = found["covariance"], found.get("stamp")
    if covariance is not None:
        covariance = [[float(f"{v:.4g}") for v in row] for row in ros_covariance(covariance, T)]
    return _feature(
        "Point",
        axes.of_poses(T[None])[0],
        name=name,
        index=found.get("index"),
        stamp=stamp,
        time=_utc(stamp),
        yaw_deg=round(math.degrees(geometry.heading(T)), 2),
        confidence=found.get("confidence"),
        covariance=covariance,
    )


def _utc(stamp: Any) -> str | None:
    """Return the time of a stamp in ISO 8601; None if it does not count from 1970."""
    if not isinstance(stamp, float) or not _UNIX_S[0] <= stamp < _UNIX_S[1]:
        return None
    return datetime.fromtimestamp(stamp, timezone.utc).isoformat(timespec="milliseconds")


def _feature(kind: str, coordinates: Sequence[Any], **properties: Any) -> dict[str, Any]:
    shape = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": shape}
