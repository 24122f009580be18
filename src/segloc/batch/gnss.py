"""GNSS fixes as priors of queries."""

from __future__ import annotations

import numpy as np

from ..datasets.fixes import Fixes
from ..errors import DatasetError
from ..map.georeference import Georeference
from ..prior import Prior
from ..types import Float64

LONGEST_GAP_S = 2.0
"""A query farther from a fix in time has no prior."""
UNSAID_M, SIGMAS = 10.0, 3.0
"""The error of a receiver that says none, and how many standard deviations are allowed for."""
MOST_M = 500.0
"""A fix that is worse says nothing."""


def gnss_priors(
    fixes: Fixes, georeference: Georeference, stamps: Float64 | None, least_m: float
) -> list[Prior | None]:
    """A prior for each query that has a fix near it in time.

    All of them are for a first look: what is not found there is searched for everywhere, since
    fixes between houses may be far off, and say that they are not.

    Parameters
    ----------
    fixes : Fixes
    georeference : Georeference
        Of the map.
    stamps : (N,) float64 or None
        Of the queries, seconds.
    least_m : float
        Radius of a prior whose fix is exact: the antenna, the scan and the map have errors, too.

    Raises
    ------
    DatasetError
        If the queries have no times.
    ConfigError, MissingDependency
        As :meth:`segloc.map.georeference.Georeference.in_map`.
    """
    if stamps is None:
        raise DatasetError(f"{fixes.source}: fixes are by time, and the scans have no times")
    xy = georeference.in_map(fixes.degrees)[:, :2]
    error_m = np.where(np.isfinite(fixes.error_m), fixes.error_m, UNSAID_M)
    after = np.searchsorted(fixes.stamps, stamps).clip(1, max(len(fixes) - 1, 1)) % len(fixes)
    before = np.maximum(after - 1, 0)
    sooner = stamps - fixes.stamps[before] <= fixes.stamps[after] - stamps
    nearest = np.where(sooner, before, after)
    priors: list[Prior | None] = []
    for stamp, k in zip(stamps, nearest, strict=True):
        radius_m = least_m + SIGMAS * float(error_m[k])
        late = abs(fixes.stamps[k] - stamp) > LONGEST_GAP_S
        useless = late or radius_m > MOST_M or not np.isfinite(xy[k]).all()
        priors.append(None if useless else Prior(xy[k], radius_m, anywhere=True))
    return priors
