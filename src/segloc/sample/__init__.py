"""A small simulated sample: two days of one town, and another town.

Each drive is one ``.npz`` file beside this module; the README there describes the format. The
drives are simulated, with range noise, lost and mixed returns. They are read with NumPy alone, and
the points are the same bits on every machine.
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import DatasetError
from ..types import Float64, Int64, Scan

if TYPE_CHECKING:
    from ..tools.datasets.recorded import Selection

Name: TypeAlias = Literal["monday", "tuesday", "elsewhere"]

RANGE_UNIT_M = 0.01
"""Resolution of the stored ranges [m]."""

FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class SampleDrive:
    """A simulated drive of a spinning LiDAR: N scans of B beams and F firings."""

    name: str
    indices: Int64  # (N,)
    stamps: Float64  # (N,) start of each scan [s]
    poses: Float64  # (N, 4, 4) T_odom_sensor. Those of "monday" are the truth; the others drift
    truth: Float64  # (N, 4, 4) T_world_sensor
    elevations: Float64  # (B, 2) cosine and sine of each beam's elevation
    # (C, F, 2) cosine and sine of each firing's azimuth. Beam b takes row b modulo C
    azimuths: Float64
    ranges: NDArray[np.uint16]  # (N, B, F) in units of ``RANGE_UNIT_M``; 0 is no return

    def __len__(self) -> int:
        return len(self.indices)

    def scan(self, i: int) -> Scan:
        """Return the scan at position i, with its stamp and its pose.

        Raise DatasetError if there is no position i.
        """
        if not 0 <= i < len(self):
            raise DatasetError(f"{self.name}: no scan at position {i} of {len(self)}")
        firing, beam = np.nonzero(self.ranges[i].T)
        metres = self.ranges[i][beam, firing] * RANGE_UNIT_M
        flat = metres * self.elevations[beam, 0]
        turn = self.azimuths[beam % len(self.azimuths), firing]
        points = np.stack(
            [flat * turn[:, 0], flat * turn[:, 1], metres * self.elevations[beam, 1]], axis=1
        )
        return Scan(
            points.astype(np.float32), stamp=float(self.stamps[i]), T_odom_sensor=self.poses[i]
        )

    def select(self, selection: Selection) -> SampleDrive:
        """Return the scans whose indices are selected, in the same order."""
        mask = selection.mask(self.indices)
        return replace(
            self,
            indices=self.indices[mask],
            stamps=self.stamps[mask],
            poses=self.poses[mask],
            truth=self.truth[mask],
            ranges=self.ranges[mask],
        )


def load(name: Name) -> SampleDrive:
    """Read a drive of the sample.

    Parameters
    ----------
    name : str
        "monday", a drive to map; "tuesday", another day, sensor and lane, partly off Monday's
        way; or "elsewhere", a drive in another town.

    Raises
    ------
    DatasetError
        If its file is missing or damaged.
    """
    path = FOLDER / f"{name}.npz"
    try:
        with np.load(path, allow_pickle=False) as file:
            stored = {key: file[key] for key in file.files}
        ranges = _decode(stored)
        poses, truth = stored["poses"], stored["truth"]
        return SampleDrive(
            name,
            np.arange(len(poses), dtype=np.int64),
            stored["stamps"],
            poses,
            truth,
            stored["elevations"],
            stored["azimuths"],
            ranges,
        )
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise DatasetError(f"{path}: cannot be read: reinstall segloc ({error})") from error


def _decode(stored: dict[str, NDArray[np.uint8]]) -> NDArray[np.uint16]:
    """Restore ranges (N, B, F) from returns and zigzag differences along each beam."""
    shape = len(stored["poses"]), len(stored["elevations"]), stored["azimuths"].shape[1]
    returned = np.unpackbits(stored["returned"], count=int(np.prod(shape))).astype(bool)
    zigzag = stored["low"].astype(np.uint16) | stored["high"].astype(np.uint16) << 8
    steps = (zigzag >> 1) ^ -(zigzag & 1)
    ranges = np.zeros(len(returned), dtype=np.uint16)
    ranges[returned] = np.cumsum(steps, dtype=np.uint16)
    return ranges.reshape(shape)
