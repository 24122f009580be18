"""Align sessions with drifting poses, each in its own frame, to one frame.

Submaps are localized in the earlier parts that they vote for, of other sessions and distant parts
of their own. Loops that agree with each other join the sessions in one pose graph. Once optimised,
neighbouring submaps of different passes are close enough for ICP; their loops are added and the
graph is optimised again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..config import Config
from ..errors import ConfigError
from ..types import Float64, Int64, Scanned, as_recording
from .config import AlignConfig
from .consistency import reject_unsupported
from .loops import Chain, Loop, edges_of, neighbours
from .session_graph import SessionGraph
from .submaps import Progress, Session
from .tasks import Described, Stage, describe_all, find_loops, open_workspace, tie


@dataclass(frozen=True)
class Alignment:
    """Sessions in one frame, or in as few as loops justify.

    Attributes
    ----------
    names : list of str
        Names of the sessions.
    indices : list of (N,) int64
        Scan numbers of each session.
    odometry : list of (N, 4, 4) float64
        T_odom_sensor, as given.
    poses : list of (N, 4, 4) float64
        T_world_sensor. The world of a component is the frame of its first session.
    components : list of list of int
        Connected sessions, the largest component first.
    loops : list of Loop
        Accepted and rejected.
    loop_sessions : (L, 2) int64
        The sessions of each loop's target and source.
    loop_scans : (L, 2) int64
        Scan numbers of each loop's target and source.
    """

    names: list[str]
    indices: list[Int64]
    odometry: list[Float64]
    poses: list[Float64]
    components: list[list[int]]
    loops: list[Loop]
    loop_sessions: Int64
    loop_scans: Int64


def align_sessions(
    recordings: Sequence[Scanned],
    config: Config | None = None,
    settings: AlignConfig | None = None,
    stage: Stage | None = None,
    *,
    executor: Executor | None = None,
    folder: str | Path | None = None,
) -> Alignment:
    """Bring sessions of one place into one frame.

    The result does not depend on the executor or the number of its workers.

    Parameters
    ----------
    recordings : sequence of Recording, or of lists of Scan
        With odometry: poses that may drift, each in its own frame with z up.
    config : Config, optional
        Configuration of segments, descriptors and localization.
    settings : AlignConfig, optional
    stage : callable, optional
        Called with the name of each stage; returns a context with a callable (done, total).
    executor : Executor, optional
        Runs tasks of one thread each; by default this process does. For processes and clusters,
        recordings must be picklable; workers read their files.
    folder : path, optional
        Folder for submaps (200 MB per kilometre), under the same path for all workers; emptied at
        the end. By default the system's temporary folder.

    Raises
    ------
    ConfigError
        If there are no recordings.
    DatasetError
        If a session has no scans, poses or segments; names the session.
    SeglocError
        If a file cannot be written, or a process was killed repeatedly.
    """
    config, settings, stage = config or Config(), settings or AlignConfig(), stage or silent
    if not recordings:
        raise ConfigError("no sessions to align")
    opened = [as_recording(each) for each in recordings]
    sessions = [Session.of(k, recording, settings) for k, recording in enumerate(opened)]
    chain = Chain.of(sessions, settings.part_m)
    with open_workspace(config, settings, executor, folder) as own:
        owner = [int(chain.session[nodes[0]]) for nodes in chain.parts]
        described = [
            Described(k, recording, session, chain.first(k), owner.index(k))
            for k, (recording, session) in enumerate(zip(opened, sessions, strict=True))
        ]
        describe_all(own, described, stage)
        with stage("Searching loops") as update:
            found = find_loops(own, chain, update)
        graph = SessionGraph(chain, reject_unsupported(chain, found, settings), settings)
        graph.optimise()
        for _ in range(settings.dense_rounds):
            with stage("Aligning neighbours") as update:
                pairs = neighbours(chain, graph.poses, graph.component, settings)
                dense = tie(own, pairs, update)
            graph.tie_neighbours(dense)
    return _alignment(sessions, chain, graph)


def _alignment(sessions: Sequence[Session], chain: Chain, graph: SessionGraph) -> Alignment:
    loops = graph.with_residuals()
    edges = edges_of(loops)
    ends = np.stack([edges.first, edges.second], axis=1)
    scans = np.concatenate([s.indices[s.anchors] for s in sessions])
    return Alignment(
        [s.name for s in sessions],
        [s.indices for s in sessions],
        [s.poses for s in sessions],
        [spread(s, graph.poses[chain.session == k]) for k, s in enumerate(sessions)],
        graph.components,
        loops,
        chain.session[ends],
        scans[ends],
    )


@contextmanager
def silent(label: str) -> Iterator[Progress]:
    """Provide a stage without progress output."""
    yield lambda done, total: None


def spread(session: Session, nodes: Float64) -> Float64:
    """Return T_world_sensor of every scan, (N, 4, 4).

    Interpolates between neighbouring submaps by distance travelled: linear in position, slerp in
    rotation.
    Parameters
    ----------
    session : Session
    nodes : (S, 4, 4) float64
        T_world_local of the submaps.
    """
    travelled, marks = session.travelled, session.node_travelled
    after = np.clip(np.searchsorted(marks, travelled), 1, max(len(marks) - 1, 1)) % len(marks)
    before = np.maximum(after - 1, 0)
    odometry = session.node_poses
    pair = [nodes[k] @ np.linalg.inv(odometry[k]) @ session.poses for k in (before, after)]
    length = np.where(marks[after] > marks[before], marks[after] - marks[before], 1.0)
    share = np.clip((travelled - marks[before]) / length, 0.0, 1.0)
    turn = pair[0][:, :3, :3].transpose(0, 2, 1) @ pair[1][:, :3, :3]
    part = Rotation.from_rotvec(share[:, None] * Rotation.from_matrix(turn).as_rotvec())
    result: Float64 = pair[0].copy()
    result[:, :3, :3] = pair[0][:, :3, :3] @ part.as_matrix()
    result[:, :3, 3] += share[:, None] * (pair[1][:, :3, 3] - pair[0][:, :3, 3])
    return result
