"""Align sessions with drifting poses to an existing map.

Submaps of a session are localized in the map. Each one found is an anchor; anchors that agree with
their neighbours and odometry form a pose graph with the map as one fixed node.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .. import geometry
from ..config import Config
from ..errors import ConfigError, MapMismatch
from ..localizer import Localizer
from ..map.segment_map import SegmentMap
from ..tiles import TiledMap, localizer_in
from ..types import Float64, Int64, Recording, Scanned, as_recording
from .align import silent, spread
from .config import AlignConfig
from .consistency import reject_unsupported
from .loops import Chain, Loop
from .session_graph import SessionGraph
from .submaps import Progress, Reader, Session
from .tasks import Stage

_MAP = 0  # node number
_SUBMAPS = 8  # minimum, of a short session


@dataclass(frozen=True)
class MapAlignment:
    """Sessions in the frame of a map.

    Attributes
    ----------
    names : list of str
        Names of the sessions.
    indices : list of (N,) int64
        Scan numbers of each session.
    odometry : list of (N, 4, 4) float64
        T_odom_sensor, as given.
    poses : list of (N, 4, 4) float64
        T_map_sensor.
    submaps : list of int
        Number of submaps of each session searched in the map.
    anchors : list of list of Loop
        Submaps of each session found in the map, accepted and rejected: ``source`` is the submap
        number from 1, ``T_target_source`` its T_map_local.
    unanchored_m : list of float
        Maximum travel of each session from its nearest accepted anchor [m], over which its poses
        rely on odometry.
    """

    names: list[str]
    indices: list[Int64]
    odometry: list[Float64]
    poses: list[Float64]
    submaps: list[int]
    anchors: list[list[Loop]]
    unanchored_m: list[float]


def align_to_map(
    prior_map: SegmentMap | TiledMap,
    recordings: Sequence[Scanned],
    config: Config | None = None,
    settings: AlignConfig | None = None,
    stage: Stage | None = None,
) -> MapAlignment:
    """Align sessions with drifting poses to the frame of a map.

    Parameters
    ----------
    prior_map : SegmentMap or TiledMap
    recordings : sequence of Recording, or of lists of Scan
        With odometry: poses that may drift, each in its own frame with z up.
    config : Config, optional
        Configuration of descriptors and localization; by default the map's.
    settings : AlignConfig, optional
    stage : callable, optional
        Called with the name of each stage; returns a context with a callable (done, total).

    Raises
    ------
    MapMismatch
        If too few submaps of a session are found in the map, or they disagree, or the map has
        another descriptor.
    ConfigError
        If there are no recordings.
    DatasetError
        If a session has no scans or no poses; names the session.
    """
    settings, stage = settings or AlignConfig(), stage or silent
    if not recordings:
        raise ConfigError("no sessions to align")
    localizer = localizer_in(prior_map, config)
    found = MapAlignment([], [], [], [], [], [], [])
    for k, given in enumerate(recordings):
        recording = as_recording(given)
        session = _session(k, recording, settings)
        with stage(f"Localizing session {k + 1} of {len(recordings)}") as update:
            loops = _localize(recording, session, localizer, settings, update)
        _append(found, k, session, loops, settings)
    return found


def _session(k: int, recording: Recording, settings: AlignConfig) -> Session:
    """Split a recording into submaps, closer together if it is short."""
    session = Session.of(k, recording, settings)
    if len(recording) > 1 and len(session.anchors) < _SUBMAPS and session.travelled[-1] > 0:
        closer = min(settings.every_m, float(session.travelled[-1]) / _SUBMAPS)
        session = Session.of(k, recording, settings.model_copy(update={"every_m": closer}))
    return session


def _localize(
    recording: Recording,
    session: Session,
    localizer: Localizer,
    settings: AlignConfig,
    progress: Progress,
) -> list[Loop]:
    """Localize submaps in the map; return loops from the map's node."""
    reader, loops = Reader(recording, session.poses, localizer.config), []
    for number, anchor in enumerate(session.anchors, 1):
        cloud = reader.cloud(int(anchor), localizer.config.local_cloud.window_m)
        answer = localizer.locate(localizer.describe(cloud))
        progress(number, len(session.anchors))
        if not answer.localized or answer.covariance is None:
            continue
        T_sensor_local = geometry.inverse(cloud.T_local_sensor)
        covariance = geometry.rotated_covariance(answer.covariance, T_sensor_local)
        assert covariance is not None
        loops.append(
            Loop(
                _MAP,
                number,
                answer.T_map_sensor @ T_sensor_local,
                covariance + settings.least_covariance(),
                "found",
                answer.inliers,
                answer.overlap,
            )
        )
    return loops


def _chain(session: Session) -> Chain:
    """Return a chain of the map as a session of one node, and the session's submaps."""
    count = len(session.anchors)
    return Chain(
        np.repeat(np.arange(2), [1, count]),
        np.concatenate([[0.0], session.node_travelled]),
        np.concatenate([np.eye(4)[None], session.node_poses]),
        [],
    )


def _append(
    found: MapAlignment, k: int, session: Session, loops: list[Loop], settings: AlignConfig
) -> None:
    """Solve a session's graph, and append it to the result.

    Raises
    ------
    MapMismatch
        If too few anchors agree.
    """
    chain = _chain(session)
    supported = reject_unsupported(chain, loops, settings, len(session.anchors) - 1)
    graph = SessionGraph(chain, supported, settings)
    graph.optimise()
    accepted = [loop for loop in graph.loops if loop.accepted]
    needed = min(settings.min_support + 1, len(session.anchors))
    if len(accepted) < needed:
        raise MapMismatch(
            f"session {k}: {session.name} does not meet the map: {len(loops)} of "
            f"{len(session.anchors)} places along it are found in the map, of which "
            f"{len(accepted)} agree (at least {needed} must). Is it of another place, or are its "
            "scans or poses faulty (`segloc doctor`)?"
        )
    marks = chain.travelled[[loop.source for loop in accepted]]
    apart = np.abs(session.travelled[:, None] - marks[None]).min(axis=1)
    found.names.append(session.name)
    found.indices.append(session.indices)
    found.odometry.append(session.poses)
    found.poses.append(spread(session, graph.poses[1:]))
    found.submaps.append(len(session.anchors))
    found.anchors.append(graph.with_residuals())
    found.unanchored_m.append(float(apart.max()))
