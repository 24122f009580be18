"""Aligned sessions -> one map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce

from ..config import Config
from ..errors import ConfigError
from ..map.build import build_map
from ..map.compact import compacted
from ..map.segment_map import SegmentMap
from ..types import Recording


def build_merged_map(
    recordings: Sequence[Recording],
    config: Config,
    progress: Callable[[int, int], None] | None = None,
) -> SegmentMap:
    """A map of several sessions whose poses share a frame.

    Parameters
    ----------
    recordings : sequence of Recording
        The segments of the first are marked as session 0, and so on.
    config : Config
    progress : callable, optional
        Called with (sessions done, sessions in all).

    Raises
    ------
    ConfigError
        If there is no recording.
    DatasetError
        If a recording has no poses, or nothing that could be segmented.
    """
    if not recordings:
        raise ConfigError("there is no session to map")
    maps: list[SegmentMap] = []
    for done, recording in enumerate(recordings):
        maps.append(build_map(recording, config))
        if progress:
            progress(done + 1, len(recordings))
    return compacted(reduce(SegmentMap.merge, maps), config.mapping.compact)
