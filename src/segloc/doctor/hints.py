"""Likely cause of failed queries: the fault of the scans, if there is one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..errors import SeglocError
from ..frontend.local_cloud import LocalCloudConfig
from ..localization import Localization
from ..map.segment_map import SegmentMap
from ..system.text import counted
from ..types import Scanned, as_recording
from .recording import first_fault

_MAX_SHARE = 0.5  # of localized queries, above which no hint is given


def hint(
    scans: Scanned,
    results: Sequence[Localization],
    config: LocalCloudConfig | None = None,
    *,
    prior_map: SegmentMap | None = None,
    known: str | None = None,
) -> str | None:
    """Return one line on why most queries fail; None if most succeed or no cause is known.

    Parameters
    ----------
    scans : Recording, or list of Scan or of (N, >=3) arrays
        The scans of the queries.
    results : list of Localization
    config : LocalCloudConfig, optional
        Mount of the sensor.
    prior_map : SegmentMap, optional
        The map; a tilted frame is also a cause.
    known : str, optional
        Cause known to the caller; no scan is then examined.
    """
    found = sum(result.localized for result in results)
    if found > _MAX_SHARE * len(results):
        return None
    failed = f"{len(results) - found} of {counted(len(results), 'queries')} failed."
    cause = known or _fault(scans, config, {} if prior_map is None else prior_map.metadata)
    if cause is not None:
        return f"{failed} Likely cause: {cause}"
    if found:
        return None
    return (
        f"{failed} No problem found in the scans: were they taken within the map? "
        "`segloc explain SCAN --map MAP` shows at which stage they fail"
    )


def _fault(
    scans: Scanned, config: LocalCloudConfig | None, metadata: Mapping[str, str]
) -> str | None:
    """Describe the first problem of the scans, or else of the map's frame."""
    try:
        finding = first_fault(as_recording(scans), config)
    except SeglocError:
        finding = None
    frame = None if "T_map_odom" in metadata else metadata.get("frame")
    if frame and not (finding is not None and finding.wrong):
        return f"the map's frame is {frame}. Build the map with --level"
    return None if finding is None else str(finding)
