"""Robots that are carried away while their odometry notices nothing: how soon is that noticed?

    python -m segloc_experiments.protocols.kidnapping [--trials 200]

Worlds are mapped in one session and driven through in another, with other cars and a tenth of the
things replaced. Each robot drives 40 m along the map, is then at another place of it, at least 20 m
away, and drives on for 100 m, as far as the drive goes. Its odometry drifts by 1 % and goes on as
if nothing had happened. Noticed: no longer localized. Recovered: localized within 2 m and 10
degrees of the truth. Held: metres localized farther off than that. Needs the extra ``sim``.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from segloc import Config, Localizer, Scan, build_map, geometry
from segloc.batch.score import COVERAGE_RADIUS_M, distances_to_path
from segloc.live.replay import Replay, replay
from segloc.live.score import pose_errors
from segloc.reposed import Derived
from segloc.simulation import (
    SCENES,
    SENSORS,
    Conditions,
    OdometryNoise,
    SimulatedSequence,
    simulate_sessions,
)
from segloc.types import Float64, Int64, Recording
from segloc.views import Status

from ..script import head, parser, row

WORLDS = (("town", "hdl64e"), ("park", "hdl64e"), ("industrial", "vlp16"), ("town", "vlp16"))
BEFORE_M, AFTER_M, AWAY_M, SPACING_M = 40.0, 100.0, 20.0, 2.0
OFF_M, OFF_DEG = 2.0, 10.0
NOTICED_M, RECOVERED_M, HELD_M = 30.0, 60.0, 5.0
DRIFT = OdometryNoise(drift_m=0.03, drift_deg=0.04, scale=0.01)


@dataclass(frozen=True)
class Carried(Derived[Recording]):
    """Parts of a drive one after another, with odometry that goes on between them.

    Attributes
    ----------
    positions : (N,) int64
        In the drive.
    poses : (N, 4, 4) float64
    """

    positions: Int64
    poses: Float64

    @property
    def indices(self) -> Int64:
        return np.arange(len(self.positions), dtype=np.int64)

    @property
    def stamps(self) -> Float64 | None:
        return None

    def __len__(self) -> int:
        return len(self.positions)

    def scan(self, i: int) -> Scan:
        return self.source.scan(int(self.positions[i]))


@dataclass(frozen=True)
class Outcome:
    """Metres; infinite where it did not happen."""

    fixed: bool  # before it was carried
    noticed: float
    recovered: float
    held: float

    @property
    def good(self) -> bool:
        soon = self.noticed <= NOTICED_M and self.recovered <= RECOVERED_M
        return soon and self.held <= HELD_M


class Kept(Derived[Recording]):
    """A drive whose scans are cast once."""

    def __init__(self, drive: SimulatedSequence) -> None:
        super().__init__(drive)
        object.__setattr__(self, "poses", drive.truth)
        object.__setattr__(self, "_scans", {})

    poses: Float64
    _scans: dict[int, Scan]

    def scan(self, i: int) -> Scan:
        if i not in self._scans:
            self._scans[i] = Scan(self.source.scan(i).points)
        return Scan(self._scans[i].points)


def trials(truths: Float64, path: Float64, rng: np.random.Generator) -> Iterator[tuple[int, int]]:
    """Where robots are taken from and to: places of the map, with enough of the drive around."""
    inside = np.flatnonzero(distances_to_path(truths, path) <= COVERAGE_RADIUS_M)
    before, after = int(BEFORE_M / SPACING_M), int(RECOVERED_M / SPACING_M)
    whole = [k for k in inside if set(range(k, k + after)) <= set(inside.tolist())]
    while True:
        a = int(rng.choice(inside[inside >= before]))
        away = np.linalg.norm(truths[whole, :2, 3] - truths[a, :2, 3], axis=1)
        far = np.array(whole)[away >= AWAY_M]
        if len(far):
            yield a, int(rng.choice(far))


def carried(drive: Kept, taken: int, put: int, rng: np.random.Generator) -> Carried:
    """The scans up to a place and from another on."""
    first = np.arange(taken - int(BEFORE_M / SPACING_M), taken + 1)
    second = np.arange(put, min(put + int(AFTER_M / SPACING_M), len(drive)))
    truths = drive.poses
    T = truths[taken] @ geometry.inverse(truths[put])  # as if it had gone on from there
    moved = np.concatenate([truths[first], T @ truths[second]])
    positions = np.concatenate([first, second])
    return Carried(drive, positions, DRIFT.odometry(moved, rng))


def outcome(played: Replay, recording: Carried, truths: Float64) -> Outcome:
    """What came of it."""
    count = int(BEFORE_M / SPACING_M) + 1
    metres, degrees = pose_errors(played, truths[recording.positions])
    sure = np.array([played.states[int(k)].status is Status.LOCALIZED for k in played.positions])
    right = sure & (metres <= OFF_M) & (degrees <= OFF_DEG)
    false = sure & ~right
    path = geometry.travelled(truths[recording.positions[count:]])

    def first(found: NDArray[np.bool_]) -> float:
        return float(path[int(found.argmax())]) if found.any() else float("inf")

    held = SPACING_M * float(false[count:].sum())
    return Outcome(bool(right[count - 1]), first(~false[count:]), first(right[count:]), held)


def run(scene: str, sensor: str, seed: int, count: int, length_m: float) -> list[Outcome]:
    """Trials in one world."""
    mapped, driven = simulate_sessions(
        SCENES[scene](seed),
        SENSORS[sensor]().thinned(4 if sensor == "hdl64e" else 2),
        [Conditions(), Conditions(replaced=0.1)],
        length_m=length_m,
        spacing_m=SPACING_M,
        seed=seed,
    )
    config = Config(threads=1)
    prior_map = build_map(mapped, config)
    localizer, drive = Localizer(prior_map, config), Kept(driven)
    rng = np.random.default_rng(seed)
    found = []
    for taken, put in islice(trials(drive.poses, prior_map.trajectory, rng), count):
        recording = carried(drive, taken, put, rng)
        found.append(outcome(replay(localizer, recording), recording, drive.poses))
    return found


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--trials", type=int, default=200)
    options.add_argument("--worlds", type=int, default=8, help="drives; scenes take turns")
    options.add_argument("--length", type=float, default=400.0, help="metres of each drive")
    options.add_argument("--first-seed", type=int, default=4100)
    args = options.parse_args()
    print(
        head(
            *("world", "trials", "known before", f"noticed within {NOTICED_M:g} m"),
            *(f"recovered within {RECOVERED_M:g} m", f"false for more than {HELD_M:g} m"),
            *("noticed, median / worst (m)", "recovered, median / worst (m)", "held, worst (m)"),
        )
    )
    everything: list[Outcome] = []
    for k in range(args.worlds):
        scene, sensor = WORLDS[k % len(WORLDS)]
        count = args.trials // args.worlds + (k < args.trials % args.worlds)
        found = run(scene, sensor, args.first_seed + k, count, args.length)
        everything += found
        print(_row(f"{scene}, {sensor}, {args.first_seed + k}", found), flush=True)
    print(_row("all", everything))


def _row(name: str, found: list[Outcome]) -> str:
    known = [each for each in found if each.fixed]
    noticed = np.array([each.noticed for each in known])
    recovered = np.array([each.recovered for each in known])
    held = np.array([each.held for each in known])

    def spread(values: Float64) -> str:
        return f"{np.median(values):.0f} / {values.max():.0f}" if len(values) else "-"

    return row(
        *(name, len(found), len(known), (noticed <= NOTICED_M).sum()),
        *((recovered <= RECOVERED_M).sum(), (held > HELD_M).sum()),
        *(spread(noticed), spread(recovered), f"{held.max(initial=0.0):.0f}"),
    )


if __name__ == "__main__":
    main()
