"""Ask maps for places that they do not hold: every localized query is false.

Scans of simulated towns, single and accumulated, are asked in maps of other places (``.segmap``
files, of any recording), and in the map of another simulated town; real recordings in the maps of
all these towns.

    python benchmarks/negatives.py --towns 2 first.segmap later.segmap \
      --real DATA/keyframes=DATA/keyframes.tum DATA/scans=DATA/scans.tum
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from segloc import Config, Localization, Localizer, SegmentMap, build_map
from segloc.datasets import Sequence, open_sequence
from segloc.local_cloud import window
from segloc.simulation import demo_sessions
from segloc.types import LocalCloud

SCANS_IN_MEMORY = 48


def clouds(drive: Sequence, localizer: Localizer, step: int = 1) -> Iterator[LocalCloud]:
    """A local cloud of every ``step``-th scan alone, and one accumulated behind every fourth."""
    config, poses = localizer.config.local_cloud, drive.poses
    assert poses is not None
    scan = lru_cache(SCANS_IN_MEMORY)(drive.scan)  # windows overlap, and casting takes longest
    for n, i in enumerate(range(0, len(drive), step)):
        yield localizer.accumulator.gather(scan(i))
        if i >= 8 and n % 4 == 0:
            behind = window(poses, i, config.window_m, centred=False, max_gap_m=config.max_gap_m)
            yield localizer.accumulator.gather([scan(k) for k in behind])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("maps", nargs="*", type=Path)
    parser.add_argument("--towns", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=4000)
    parser.add_argument("--method", default="profile")
    parser.add_argument("--real", nargs="*", default=[], metavar="SCANS=POSES")
    parser.add_argument("--real-every", type=int, default=8, metavar="SCANS")
    args = parser.parse_args()

    config = Config.preset(args.method).model_copy(update={"threads": 1})
    drives = demo_sessions(args.first_seed - 1)
    sites = {"simulated town": build_map(drives["map"], config)}
    sites |= {path.name: SegmentMap.load(path) for path in args.maps}
    localizers = {name: Localizer(prior_map, config) for name, prior_map in sites.items()}
    answers: dict[str, list[Localization]] = {name: [] for name in sites}
    any_localizer = localizers["simulated town"]  # clouds are gathered alike for all maps
    real = [open_sequence(*map(Path, pair.split("="))) for pair in args.real]
    asked = [cloud for drive in real for cloud in clouds(drive, any_localizer, args.real_every)]
    for seed in range(args.first_seed, args.first_seed + args.towns):
        drives = demo_sessions(seed)
        for drive in drives.values():
            for cloud in clouds(drive, any_localizer):
                for name, localizer in localizers.items():
                    answers[name].append(localizer.localize(cloud))
        if asked:
            town = Localizer(build_map(drives["map"], config), config)
            answers[f"town {seed}, asked by real scans"] = [town.localize(c) for c in asked]
        report(answers)


def report(answers: dict[str, list[Localization]]) -> None:
    """Counts for every map, and what so many queries say of the rate."""
    total = Counter(false=0, queries=0)
    for name, results in answers.items():
        false = sum(r.localized for r in results)
        total.update(false=false, queries=len(results))
        most = max(r.inliers for r in results)
        print(f"{name}: {false} false of {len(results)}, most inliers {most}", flush=True)
    if not total["false"]:
        bound = 1 - math.exp(math.log(0.05) / total["queries"])
        print(f"false rate below {100 * bound:.2f} % with 95 % confidence", flush=True)


if __name__ == "__main__":
    main()
