"""Georeference of a map: a projected frame by its EPSG code, and the map's origin in it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ..errors import ConfigError, MapFormatError, requires
from ..system.checks import MAX_METRES
from ..types import Float64

KEY = "georeference"
"""Key in the metadata of a map."""
_WGS84 = 4979  # latitude, longitude, and height above the ellipsoid


@dataclass(frozen=True)
class Georeference:
    """Offset of the map in a projected frame; the axes are the same.

    Attributes
    ----------
    epsg : int
        Code of a projected frame with east and north axes in metres, such as 25832.
    origin_m : (float, float, float)
        East, north and up of the map's origin in that frame.

    Raises
    ------
    ConfigError
        If a number is implausible.
    """

    epsg: int
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not 1 <= self.epsg <= 999_999:
            raise ConfigError(f"{self.epsg} is not an EPSG code")
        origin = np.array(self.origin_m, np.float64)
        if origin.shape != (3,) or not (np.abs(origin) <= MAX_METRES).all():
            raise ConfigError(f"the origin of a map must be east, north, up, not {self.origin_m!r}")

    @classmethod
    def of(cls, metadata: Mapping[str, str]) -> Georeference | None:
        """Return the georeference in a map's metadata; None if it has none.

        Raises
        ------
        MapFormatError
            If it cannot be read, or maps with several were merged.
        """
        text = metadata.get(KEY)
        if text is None:
            return None
        try:
            values: Any = json.loads(text)
            east, north, up = map(float, values["origin_m"])
            return cls(int(values["epsg"]), (east, north, up))
        except (ValueError, KeyError, TypeError, RecursionError, ConfigError) as error:
            raise MapFormatError(f"metadata: invalid georeference: {text[:80]!r}") from error

    def to_text(self) -> str:
        """Return the text for a map's metadata."""
        return json.dumps({"epsg": self.epsg, "origin_m": [float(m) for m in self.origin_m]})

    def __str__(self) -> str:
        return f"EPSG:{self.epsg}, origin at {', '.join(f'{m:g}' for m in self.origin_m)}"

    def in_map(self, degrees: Float64) -> Float64:
        """Convert (N, 3) longitude, latitude [deg] and height [m] in WGS 84 to map coordinates.

        Points outside the frame are not finite.

        Raises
        ------
        ConfigError
            If the EPSG code is not a projected frame in metres.
        MissingDependency
            If pyproj is not installed.
        """
        there, _ = _transformers(self.epsg)
        xyz = np.column_stack(there.transform(*np.asarray(degrees, np.float64).T))
        return np.asarray(xyz - np.array(self.origin_m), dtype=np.float64)

    def on_globe(self, xyz: Float64) -> Float64:
        """Convert (N, 3) map coordinates to longitude, latitude [deg] and height [m] in WGS 84.

        Raises as :meth:`in_map`.
        """
        _, back = _transformers(self.epsg)
        found = back.transform(*(np.asarray(xyz, np.float64) + np.array(self.origin_m)).T)
        return np.asarray(np.column_stack(found), dtype=np.float64)


@lru_cache(maxsize=4)
def _transformers(epsg: int) -> tuple[Any, Any]:
    """Return transformers from WGS 84 to a projected frame, and back."""
    with requires("pyproj", "geo", f"EPSG:{epsg}"):
        import pyproj
    try:
        frame = pyproj.CRS.from_epsg(epsg)
    except pyproj.exceptions.CRSError as error:
        raise ConfigError(f"EPSG:{epsg}: unknown to pyproj") from error
    metres = all(axis.unit_conversion_factor == 1.0 for axis in frame.axis_info)
    if not (frame.is_projected and metres):
        raise ConfigError(f"EPSG:{epsg} ({frame.name}) is not a projected frame in metres")
    options = {"always_xy": True}
    return (
        pyproj.Transformer.from_crs(_WGS84, frame, **options),
        pyproj.Transformer.from_crs(frame, _WGS84, **options),
    )
