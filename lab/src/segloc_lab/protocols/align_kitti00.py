"""Three drifting sessions of KITTI 00 brought into one frame.

    python -m segloc_lab.protocols.align_kitti00 DATA

DATA holds ``keyframes/`` and ``keyframes.tum``. The drive is cut in three; each part gets 1 % of
drift and a frame of its own. Ground truth is good to a metre only across passes, so pairs of poses
of two sessions are compared with ground truth that ICP corrected: the clouds that each pass saw by
ground truth, registered with each other.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from segloc import Config, geometry
from segloc.frontend import Accumulator, window
from segloc.loops import AlignConfig, Alignment, Reposed, align_sessions
from segloc.system import kernels
from segloc.types import Float32, Float64, Pose, Recording

from ..kitti00 import keyframes, poses_of
from ..outcomes import pose_error
from ..report import Cell, Table, publish, reporting
from ..simulation import OdometryNoise
from ..training.session_registration import Registration

SESSIONS = ("0:620", "621:1200", "1201:1820")
DRIFT = OdometryNoise(drift_m=0.03, drift_deg=0.04, scale=0.01)
PLACE_M = 5.0
FALSE_M, FALSE_DEG = 3.0, 5.0
EVERY = 3  # of the scans with a place in the other session
CLOUD_M = 16.0

Errors = dict[tuple[int, int], Float64]
"""Errors of pairs of poses [m, deg], (n, 2), by pair of sessions."""


def drifted(source: Recording, truth: Float64, rng: np.random.Generator) -> Reposed:
    """Return the recording with 1 % of drift, in its own frame."""
    frame = geometry.yaw_transform(
        float(rng.uniform(-np.pi, np.pi)), tuple(rng.uniform(-500, 500, 3).tolist())
    )
    return Reposed(source, frame @ DRIFT.odometry(truth, rng))


def local_cloud(recording: Reposed, i: int) -> tuple[Pose, Float32]:
    """Return the pose of a submap around a scan by ground truth, and its points."""
    scans = window(recording.poses, i, CLOUD_M, centred=True, max_gap_m=10.0)
    cloud = Accumulator().gather([recording.scan(k) for k in scans], i - scans.start)
    return geometry.levelled(recording.poses[i]), kernels.voxel_grid(cloud.points, 0.3)


def reference(a: Reposed, i: int, b: Reposed, j: int) -> Pose | None:
    """Return T_a_b of two scans by ground truth and ICP; None if ICP fails."""
    T_a, cloud_a = local_cloud(a, i)
    T_b, cloud_b = local_cloud(b, j)
    registration = Registration(geometry.transform(T_a, cloud_a).astype(np.float32))
    correction = registration.corrected(T_b, cloud_b) @ geometry.inverse(T_b)
    if not registration.accepted:
        return None
    T_a_b: Pose = geometry.inverse(a.poses[i]) @ correction @ b.poses[j]
    return T_a_b


def pairs_across(a: Float64, b: Float64) -> list[tuple[int, int]]:
    """Return the poses of b with one of a near by, and the nearest of a."""
    apart = np.linalg.norm(a[:, None, :2, 3] - b[None, :, :2, 3], axis=2)
    near = np.flatnonzero(apart.min(axis=0) < PLACE_M)
    return [(int(apart[:, j].argmin()), int(j)) for j in near]


def off(wanted: Pose, a: Pose, b: Pose) -> tuple[float, float]:
    """Return the error of b relative to a [m, deg]; ``wanted`` is the true T_a_b."""
    delta = geometry.inverse(wanted) @ geometry.inverse(a) @ b
    return float(np.linalg.norm(delta[:3, 3])), np.degrees(geometry.rotation_angle(delta))


def errors(truth: list[Reposed], found: Alignment) -> Errors:
    """Return the errors of pairs of poses against the reference."""
    result = {}
    for b in range(len(truth)):
        for a in range(b):
            rows = []
            for i, j in pairs_across(truth[a].poses, truth[b].poses)[::EVERY]:
                wanted = reference(truth[a], i, truth[b], j)
                if wanted is not None:
                    rows.append(off(wanted, found.poses[a][i], found.poses[b][j]))
            result[a, b] = np.array(rows).reshape(-1, 2)
    return result


def false_loops(
    pose: Callable[[int, int], Pose], found: Alignment, most_deg: float = np.inf
) -> int:
    """Return accepted loops that disagree with the true poses, by session and number of a scan."""
    count = 0
    rows = zip(found.loops, found.loop_sessions.tolist(), found.loop_scans.tolist(), strict=True)
    for loop, sessions, scans in rows:
        a, b = (geometry.levelled(pose(s, n)) for s, n in zip(sessions, scans, strict=True))
        metres, degrees = pose_error(loop.T_target_source, geometry.inverse(a) @ b)
        count += bool(loop.accepted and (metres > FALSE_M or degrees > most_deg))
    return count


@contextmanager
def timed(label: str) -> Iterator[Callable[[int, int], None]]:
    """Print how long each part took."""
    began = time.perf_counter()
    yield lambda done, total: None
    print(f"{label}: {time.perf_counter() - began:.0f} s", flush=True)


def tell(title: str, found: Alignment, false: int, pairs: Errors, folder: Path | None) -> None:
    """Publish the errors between sessions, with a note on loops and time."""
    named = {f"{a} and {b}": each for (a, b), each in pairs.items() if len(each)}
    named["all"] = np.concatenate([np.zeros((0, 2)), *named.values()])
    accepted = sum(loop.accepted for loop in found.loops)
    rejected = len(found.loops) - accepted
    note = (
        f"{accepted} loops accepted, {false} of them false, {rejected} rejected; "
        f"connected components: {len(found.components)}. {time.process_time() / 60:.0f} minutes of "
        "a core, simulation or reading included."
    )
    rows = [{"sessions": label, **_figures(each)} for label, each in named.items()]
    publish(folder, title, Table.of(rows, note))


def _figures(rows: Float64) -> dict[str, Cell]:
    metres, degrees = rows.T if len(rows) else np.full((2, 1), np.nan)
    values = {
        "median (m)": np.median(metres),
        "90 % (m)": np.percentile(metres, 90),
        "largest (m)": metres.max(),
        "median (degrees)": np.median(degrees),
    }
    found = {name: round(float(v), 2) if len(rows) else None for name, v in values.items()}
    return {"pairs of poses": len(rows), **found}


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--threads", type=int, default=1)
    args = options.parse_args()
    parts = [keyframes(args.data, selection) for selection in SESSIONS]
    truth = [Reposed(part, poses_of(part)) for part in parts]
    rng = np.random.default_rng(args.seed)
    sessions = [drifted(each.source, each.poses, rng) for each in truth]
    found = align_sessions(sessions, Config(threads=args.threads), AlignConfig(), timed)
    where = [{int(n): k for k, n in enumerate(each.indices)} for each in truth]
    false = false_loops(lambda s, n: truth[s].poses[where[s][n]], found, FALSE_DEG)
    tell("Three sessions of KITTI 00 aligned", found, false, errors(truth, found), args.report)


if __name__ == "__main__":
    main()
