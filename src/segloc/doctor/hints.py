"""Why most queries of a recording fail: the fault of its scans behind it, if there is one."""

from __future__ import annotations

from collections.abc import Sequence

from ..errors import SeglocError
from ..frontend.local_cloud import LocalCloudConfig
from ..localization import Localization
from ..types import Scanned, as_recording
from .recording import first_fault

_MOST = 0.5


def hint(
    scans: Scanned, results: Sequence[Localization], config: LocalCloudConfig | None = None
) -> str | None:
    """Say in one line why most queries fail; None where most do not, or no reason is known.

    Parameters
    ----------
    scans : Recording, or list of Scan or of (N, >=3) arrays
        That the queries are from.
    results : list of Localization
        Their answers.
    config : LocalCloudConfig, optional
        How the sensor is mounted.
    """
    found = sum(result.localized for result in results)
    if found > _MOST * len(results):
        return None
    failed = f"{len(results) - found} of {len(results)} queries are not localized"
    try:
        finding = first_fault(as_recording(scans), config)
    except SeglocError:
        finding = None
    if finding is not None:
        return f"{failed}, and this may be why: {finding}"
    if found:
        return None
    return (
        f"{failed}, and nothing wrong is found with the scans: were they taken within the map? "
        "`segloc explain SCAN --map MAP` shows what is missing"
    )
