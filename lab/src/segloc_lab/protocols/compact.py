r"""What compact maps lose: real queries in a map as it was measured, and in smaller ones.

Every map of ``protocols.real`` is built once with all that was measured, and made compact in
several ways. Queries of a place are localized in each; what is found is compared with what the
whole map answers.

    python -m segloc_lab.protocols.compact DATA OUT --ways whole default compact
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Localizer, SegmentMap
from segloc.map import CompactConfig, MappingConfig, VoxelCloud, compacted
from segloc.proposals import Query
from segloc.tools.batch import query_clouds
from segloc.types import Float64

from ..outcomes import is_covered, outcome, path_km, pose_error
from ..report import Cell, Table, publish, reporting, share
from .real import maps, queries, sources

REPEATS = 5
SIZES = ("way", "map", "km", "segments", "MB a km", "ms to load a km")
COLUMNS = ("way", "queries", "found within map coverage", "false", "shift m, median", "95 %")
_WHOLE = MappingConfig(compact=CompactConfig(enabled=False))


def _some(**values: Any) -> MappingConfig:
    """All measurements except one."""
    kept = {"bits": 12, "max_views": 0, "cloud_bits": 4}
    return MappingConfig(compact=CompactConfig.model_validate({**kept, **values}))


WAYS: dict[str, MappingConfig] = {
    "whole": _WHOLE,
    "default": MappingConfig(),
    "compact": MappingConfig().smallest(),
    "5 bits": _some(bits=5),
    "4 bits": _some(bits=4),
    "4 views": _some(max_views=4),
    "2 views": _some(max_views=2),
    "1 view": _some(max_views=1),
    "half voxels": _some(cloud_bits=1),
    "voxel centres": _some(cloud_bits=0),
}


def made(whole: SegmentMap, mapping: MappingConfig) -> SegmentMap:
    """Rebuild a map from the complete one with other settings."""
    cloud = VoxelCloud(whole.cloud, whole.origin, whole.cloud_voxel)
    cloud = cloud.move_to(whole.origin, mapping.cloud_voxel)
    named = whole.descriptor, whole.fingerprint
    moved = SegmentMap(*named, whole.columns(), cloud, whole.trajectory, whole.metadata)
    return compacted(moved, mapping.compact)


def load_ms(path: Path) -> float:
    """Return the minimum processor time of several loads."""
    spent = []
    for _ in range(REPEATS):
        start = time.process_time()
        SegmentMap.load(path)
        spent.append(1e3 * (time.process_time() - start))
    return min(spent)


class Comparison:
    """Results in maps of one kind, beside those in complete maps."""

    def __init__(self, data: Path, config: Config, only: str, step: int) -> None:
        self._queries: list[tuple[str, tuple[str, ...], Float64, Query]] = []
        whole = config.model_copy(update={"mapping": _WHOLE})
        self.whole = maps(sources(data), whole)
        describer = Localizer(next(iter(self.whole.values())), whole)
        for chosen in queries(data, step):
            if not chosen.name.startswith(only) or not chosen.maps or chosen.truths is None:
                continue
            clouds = query_clouds(chosen.recording, chosen.positions, whole)
            for k, (cloud, times) in enumerate(clouds):
                query = describer.describe(cloud, times)
                self._queries.append((chosen.name, chosen.maps, chosen.truths[k], query))
        self._config, self._truly = whole, dict[tuple[int, str], Float64]()

    def answers(self, places: dict[str, SegmentMap]) -> list[dict[str, Any]]:
        """Return one record per query and map; the first call is the reference."""
        localizers = {name: Localizer(place, self._config) for name, place in places.items()}
        records, first = [], not self._truly
        for k, (name, own, truth, query) in enumerate(self._queries):
            for each in own:
                result = localizers[each].locate(query)
                estimate, shift = result.T_map_sensor, None
                found = outcome(estimate, truth)
                near = is_covered(truth, localizers[each].prior_map.trajectory)
                if estimate is not None and first:
                    self._truly[k, each] = estimate
                elif estimate is not None and found == "found" and (k, each) in self._truly:
                    shift = pose_error(estimate, self._truly[k, each])[0]
                records.append({"queries": name, "near": near, "outcome": found, "shift_m": shift})
        return records


def counted(way: str, records: list[dict[str, Any]]) -> Iterator[tuple[Cell, ...]]:
    """Return one row per set of queries."""
    for name in dict.fromkeys(r["queries"] for r in records):
        here = [r for r in records if r["queries"] == name]
        near = [r for r in here if r["near"]]
        shifts = [r["shift_m"] for r in here if r["shift_m"] is not None]
        spread = [round(float(np.quantile(shifts, q)), 2) for q in (0.5, 0.95)] if shifts else []
        false = sum(r["outcome"] == "false" for r in here)
        found = share(sum(r["outcome"] == "found" for r in near), len(near))
        yield way, name, found, false, *(spread or (None, None))


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("out", type=Path)
    options.add_argument("--method", default="profile")
    options.add_argument("--only", default="", help="queries whose name starts so")
    options.add_argument("--step", type=int, default=1, help="use every STEP-th query of KITTI")
    options.add_argument("--ways", nargs="*", default=list(WAYS), choices=list(WAYS))
    args = options.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    config = Config.preset(args.method).model_copy(update={"threads": 1})
    comparison = Comparison(args.data, config, args.only, args.step)
    sizes: list[tuple[Cell, ...]] = []
    rows: list[tuple[Cell, ...]] = []
    for way in dict.fromkeys(["whole", *args.ways]):
        places = {name: made(place, WAYS[way]) for name, place in comparison.whole.items()}
        for name, place in places.items():
            path, km = args.out / f"{name}, {way}.segmap", path_km(place.trajectory)
            place.save(path)
            megabytes = round(path.stat().st_size / 1e6 / km, 2)
            size = len(place), megabytes, round(load_ms(path) / km)
            sizes.append((way, name, round(km, 2), *size))
        rows += counted(way, comparison.answers(places))
    tables = Table(SIZES, sizes, title="Sizes"), Table(COLUMNS, rows, title="Queries")
    publish(args.report, "What compact maps save and lose", *tables)


if __name__ == "__main__":
    main()
