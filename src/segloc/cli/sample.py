"""``segloc sample``"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ..simulation import SimulatedSequence

SIZE_M, ELSEWHERE_SIZE_M, LENGTH_M = 180.0, 140.0, 160.0
MAP_EVERY_M, QUERY_EVERY_M = 2.0, 10.0
ELSEWHERE = 1000  # added to the seed: another town
_COMMANDS = """
segloc doctor {out}/monday --poses poses.tum
segloc map build {out}/monday --poses poses.tum --out {out}/site.segmap
segloc localize {out}/tuesday --map {out}/site.segmap --truth poses.tum --out {out}/results --debug
segloc explain {out}/elsewhere.npy --map {out}/site.segmap
segloc view {out}/site.segmap {out}/results
"""


def sample(
    out: Annotated[Path, typer.Option(metavar="DIR", help="The folder to write to.")] = Path(
        "sample"
    ),
    seed: Annotated[
        int, typer.Option(min=0, metavar="NUMBER", help="Another seed is another town.")
    ] = 0,
    workers: Annotated[
        int, typer.Option(min=1, metavar="COUNT", help="Processes that cast rays.")
    ] = 2,
) -> None:
    """Write a small simulated recording to map, and scans to find in it: no data to download.

    DIR/monday is a drive with an HDL-32E; DIR/tuesday are scans of another day by an OS1-64, in
    autumn, with other cars, partly off monday's way; DIR/elsewhere.npy is a scan of another town.
    """
    from ..io import write_scan
    from ..simulation import record
    from .console import busy, progress
    from .results import check_folder

    check_folder(out)
    with busy("Building two towns"):
        monday, tuesday, elsewhere = drives(seed)
    for name, drive in (("monday", monday), ("tuesday", tuesday)):
        with progress(name) as update:
            record(drive, out / name, workers=workers, progress=update)
    write_scan(out / "elsewhere.npy", elsewhere.scan(0).points)
    print(f"{out}: {len(monday)} scans to map, {len(tuesday)} to find in the map. Now:")
    print(_COMMANDS.format(out=out), end="")


def drives(seed: int) -> tuple[SimulatedSequence, SimulatedSequence, SimulatedSequence]:
    """The drive to map, the one to localize, and one in another town."""
    from ..simulation import Conditions, car, hdl32e, os1_64, simulate_sessions
    from ..simulation.worlds.town import town

    here, there = town(seed, size_m=SIZE_M), town(seed + ELSEWHERE, size_m=ELSEWHERE_SIZE_M)
    days = [Conditions(), Conditions(foliage=0.5, replaced=0.15)]
    driven = partial(simulate_sessions, seed=seed, platform=car())
    monday = driven(here, hdl32e(700), days[:1], length_m=LENGTH_M, spacing_m=MAP_EVERY_M)[0]
    tuesday = driven(here, os1_64(512), days, length_m=LENGTH_M, spacing_m=QUERY_EVERY_M)[1]
    elsewhere = driven(
        there, os1_64(512), days[:1], length_m=QUERY_EVERY_M, spacing_m=QUERY_EVERY_M
    )[0]
    return monday, tuesday, elsewhere
