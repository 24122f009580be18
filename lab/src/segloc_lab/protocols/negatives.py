r"""Localize what a map does not hold: every answer is false.

Scans of simulated towns, single and accumulated, are localized in maps of other places (``.segmap``
files, of any recording), and in the map of another simulated town; real recordings in the maps of
all these towns.

    python -m segloc_lab.protocols.negatives --towns 2 first.segmap later.segmap \
      --real DATA/keyframes=DATA/keyframes.tum DATA/scans=DATA/scans.tum --store docs/results
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from segloc import Config, Localization, Localizer, SegmentMap, build_map
from segloc.datasets import Recording, open_sequence
from segloc.frontend.local_cloud import window
from segloc.types import LocalCloud

from ..evaluation.intervals import share
from ..results.store import Result
from ..script import storing
from ..simulation import demo_sessions

SCANS_IN_MEMORY = 48
COLUMNS = ("in the map of", "false (95 %)", "most inliers")
COMMAND = """\
python -m segloc_lab.protocols.negatives --towns 2 first.segmap later.segmap \\
      --real DATA/keyframes=DATA/keyframes.tum DATA/scans=DATA/scans.tum --store docs/results"""
Answers = dict[str, list[Localization]]


def clouds(drive: Recording, localizer: Localizer, step: int = 1) -> Iterator[LocalCloud]:
    """A local cloud of every ``step``-th scan alone, and one accumulated behind every fourth."""
    config, poses = localizer.config.local_cloud, drive.poses
    assert poses is not None
    scan = lru_cache(SCANS_IN_MEMORY)(drive.scan)  # windows overlap, and casting takes longest
    for n, i in enumerate(range(0, len(drive), step)):
        yield localizer.accumulator.gather(scan(i))
        if i >= 8 and n % 4 == 0:
            behind = window(poses, i, config.window_m, centred=False, max_gap_m=config.max_gap_m)
            yield localizer.accumulator.gather([scan(k) for k in behind])


def rows(answers: Answers) -> list[tuple[str, str, int]]:
    """False ones and the most inliers, map by map and over all."""
    total = sum(map(len, answers.values()))
    false = sum(r.localized for results in answers.values() for r in results)
    found = [
        (name, share(sum(r.localized for r in results), len(results)), _most(results))
        for name, results in answers.items()
    ]
    return [*found, ("all", share(false, total), max(most for *_, most in found))]


def _most(results: list[Localization]) -> int:
    return max((r.inliers for r in results), default=0)


def main() -> None:
    options = storing(__doc__)
    options.add_argument("maps", nargs="*", type=Path)
    options.add_argument("--towns", type=int, default=2)
    options.add_argument("--first-seed", type=int, default=4000)
    options.add_argument("--method", default="profile")
    options.add_argument("--real", nargs="*", default=[], metavar="SCANS=POSES")
    options.add_argument("--real-every", type=int, default=8, metavar="SCANS")
    args = options.parse_args()
    config = Config.preset(args.method).model_copy(update={"threads": 1})
    first = Localizer(build_map(demo_sessions(args.first_seed - 1)["map"], config), config)
    localizers = {path.name: Localizer(SegmentMap.load(path), config) for path in args.maps}
    localizers = {"simulated town": first, **localizers}
    answers: Answers = {name: [] for name in localizers}
    recordings = [open_sequence(*pair.split("=")) for pair in args.real]
    real = [cloud for each in recordings for cloud in clouds(each, first, args.real_every)]
    for seed in range(args.first_seed, args.first_seed + args.towns):
        drives = demo_sessions(seed)
        for drive in drives.values():
            for cloud in clouds(drive, first):  # clouds are gathered alike for all maps
                for name, localizer in localizers.items():
                    answers[name].append(localizer.localize(cloud))
        if real:
            town = Localizer(build_map(drives["map"], config), config)
            answers[f"real scans in town {seed}"] = [town.localize(cloud) for cloud in real]
    note = (
        f"Queries: scans of {args.towns} simulated towns, single and accumulated, in the maps "
        f"of other places; every {args.real_every}. real scan, single and accumulated, in the "
        "maps of these towns. Maps of recordings are taken as they were given."
    )
    Result.measured(
        "negatives", COMMAND, COLUMNS, rows(answers), methods=(args.method,), note=note
    ).tell(args.store)


if __name__ == "__main__":
    main()
