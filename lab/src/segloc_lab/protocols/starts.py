"""Places that share nothing, against each other: ten other drives, and a forest.

The first scan of each drive of ``kitti_starts`` is a map, and the second ones of all other drives
are localized in it by the whole package. The stems found in these scans are localized among the
trees of ``oxford_forest_trees``, and so are its frames in the mirror image of the forest. Every
answer is false.

    python -m segloc_lab.protocols.starts DATA --store docs/results
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from segloc import Config, Localizer, Scan, build_map
from segloc.proposals.landmarks import (
    LandmarkLocalizer,
    LandmarkMap,
    LandmarkMapper,
    Landmarks,
    find_stems,
)
from segloc.types import Derived, Float64, Recording

from ..evaluation.intervals import share
from ..recordings import Files
from ..results.store import Result
from ..script import storing
from ..stems import mirrored
from .trees import Forest

COLUMNS = ("queries", "in the map of", "false (95 %)", "most inliers")
Counts = tuple[str, str, int, int, int]
"""Queries, map, false, of so many, most inliers."""


@dataclass(frozen=True)
class Alone(Derived[Recording]):
    """One scan of a recording as a recording of its own, taken at the origin."""

    position: int

    @property
    def indices(self) -> np.ndarray:
        return self.source.indices[self.position : self.position + 1]

    @property
    def poses(self) -> Float64:
        """One pose."""
        return np.eye(4)[None]

    @property
    def stamps(self) -> None:
        return None

    def __len__(self) -> int:
        return 1

    def scan(self, i: int) -> Scan:
        """The one scan, with its pose."""
        scan = self.source.scan(self.position + i)
        scan.T_odom_sensor = np.eye(4)
        return scan


def against_each_other(folder: Path, method: str) -> Counts:
    """The second scan of each drive in the first ones of all others; a drive has two files."""
    files = Files(folder)
    config = Config.preset(method).model_copy(update={"threads": 1})
    places = [
        Localizer(build_map(Alone(files, i), config), config) for i in range(0, len(files), 2)
    ]
    answers = [
        place.locate(place.describe(files.scan(2 * k + 1)))
        for i, place in enumerate(places)
        for k in range(len(places))
        if k != i
    ]
    false, most = sum(a.localized for a in answers), max(a.inliers for a in answers)
    return "starts of ten drives, a scan each", "another drive, one scan", false, len(answers), most


def in_the_forest(starts: Path, forest: Forest, every: int) -> list[Counts]:
    """Stems of the drives among the forest's trees, and its own frames behind a mirror."""
    mapper = LandmarkMapper()
    for frame, pose in zip(forest.frames, forest.poses, strict=True):
        mapper.add(frame, pose)
    whole, files = mapper.map(), Files(starts)
    stems = [find_stems(files.scan(k)) for k in range(len(files))]
    frames = forest.frames[::every]
    return [
        ("stems in starts of ten drives", "a forest", *_asked(whole, stems)),
        ("frames of the forest", "its mirror image", *_asked(mirrored(whole), frames)),
    ]


def _asked(prior_map: LandmarkMap, queries: Sequence[Landmarks]) -> tuple[int, int, int]:
    localizer = LandmarkLocalizer(prior_map)
    answers = [localizer.localize(each) for each in queries]
    return sum(a.localized for a in answers), len(answers), max(a.inliers for a in answers)


def main() -> None:
    options = storing(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--method", default="profile")
    options.add_argument("--every", type=int, default=5, help="frame of the forest")
    args = options.parse_args()
    starts = args.data / "kitti_starts"
    found = [against_each_other(starts, args.method)]
    found += in_the_forest(starts, Forest.load(args.data / "oxford_forest_trees"), args.every)
    rows = [(name, where, share(false, asked), most) for name, where, false, asked, most in found]
    command = (
        f"python -m segloc_lab.protocols.starts DATA --every {args.every} --store docs/results"
    )
    Result.measured("starts", command, COLUMNS, rows, methods=(args.method,)).tell(args.store)


if __name__ == "__main__":
    main()
