"""Where GNSS says that the scans of a recording were taken."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..map.segment_map import SegmentMap
    from ..prior import Prior
    from ..types import Int64, Recording


def gnss_priors(
    prior_map: SegmentMap,
    recording: Recording,
    positions: Int64,
    path: Path,
    near: Prior | None,
    radius: float,
) -> list[Prior | None]:
    """The priors of a bag's queries; how many have one is said.

    Raises
    ------
    ConfigError
        If the map does not say where on the globe it lies, or there is a prior already.
    """
    from ..batch.gnss import gnss_priors
    from ..datasets.fixes import read_fixes
    from ..errors import ConfigError
    from ..map.georeference import Georeference
    from .console import note

    georeference = Georeference.of(prior_map.metadata)
    if near is not None:
        raise ConfigError("--gnss and --near exclude each other")
    if georeference is None:
        raise ConfigError(
            "--gnss needs a map that says where it lies: build it with --epsg and --origin"
        )
    fixes = read_fixes(path)
    stamps = None if recording.stamps is None else recording.stamps[positions]
    priors = gnss_priors(fixes, georeference, stamps, radius)
    count = sum(prior is not None for prior in priors)
    note(f"{fixes.source}: fixes for {count} of {len(priors)} queries; others are searched for")
    return priors
