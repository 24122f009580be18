"""What to say where queries fail: the fault of the recording behind it, if there is one."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..frontend.local_cloud import LocalCloudConfig
    from ..localization import Localization
    from ..types import Recording

_MOST = 0.5


def hint(
    recording: Recording, results: Sequence[Localization], config: LocalCloudConfig
) -> str | None:
    """One line where most queries fail; None where most do not, or nothing is to be said."""
    from ..doctor import first_fault
    from ..errors import SeglocError

    found = sum(result.localized for result in results)
    if found > _MOST * len(results):
        return None
    failed = f"{len(results) - found} of {len(results)} queries are not localized"
    try:
        finding = first_fault(recording, config)
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
