"""Build a map from scans that are checked against their poses first."""

from __future__ import annotations

from collections.abc import Callable

from numpy.typing import ArrayLike

from .map import build
from .map.config import BuildConfig, checked_build_config
from .map.segment_map import SegmentMap
from .types import Scanned, as_recording


def build_map(
    scans: Scanned,
    config: BuildConfig | None = None,
    *,
    poses: ArrayLike | None = None,
    every_m: float | None = None,
    progress: Callable[[int, int], None] | None = None,
    check: bool = True,
) -> SegmentMap:
    """Build a map from scans with poses, as ``segloc map build`` does.

    Parameters
    ----------
    scans : Recording, or list of Scan or of (N, >=3) arrays
        Scans with poses that define the map frame, whose z axis must point up. A significant tilt
        is noted in ``metadata["frame"]``. With ``config.mapping.level`` the poses are levelled, and
        ``metadata["T_map_odom"]`` holds the transform.
    config : BuildConfig, optional
        Also a :class:`segloc.Config`; by default that of the default method.
    poses : (K, 4, 4) array, optional
        T_map_sensor of each scan; by default the scans' own ``T_odom_sensor``.
    every_m : float, optional
        Distance between views; overrides the configuration.
    progress : callable, optional
        Called with (views done, total).
    check : bool
        False to build the map even if scans and poses mismatch. By default some scans, and pairs of
        neighbouring clouds, are compared with the poses: half a second.

    Raises
    ------
    DatasetError
        If scans and poses mismatch (inverse poses, points in world coordinates, another unit), with
        the remedy; if there are no poses or no segments; or if levelling is requested and no scan
        shows which way is up.
    InvalidScan
        If a scan or a pose is invalid, or their numbers differ.
    ConfigError
        If ``config`` is of another type.
    """
    recording = as_recording(scans, poses)
    if check and recording.poses is not None:
        from .tools.doctor import require_mappable

        where = checked_build_config(config).local_cloud
        require_mappable(recording, where, recording.name, "check=False")
    return build.build_map(recording, config, every_m=every_m, progress=progress)
