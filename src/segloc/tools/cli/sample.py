"""``segloc sample``"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .console import progress

if TYPE_CHECKING:
    from ...sample import SampleDrive

TUESDAY_STEP = 2
"""Every second scan of Tuesday is written: queries are single scans, 9 m apart."""

_COMMANDS = """
segloc doctor {out}/monday --poses poses.tum
segloc map build {out}/monday --poses poses.tum --out {out}/site.segmap
segloc localize {out}/tuesday --map {out}/site.segmap --truth poses.tum --out {out}/results --debug
segloc explain {out}/elsewhere.npy --map {out}/site.segmap
segloc view {out}/site.segmap {out}/results
"""


def sample(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Output folder.")] = Path("sample"),
) -> None:
    """Write a small simulated recording to map, and scans to localize in it (no download).

    DIR/monday is a drive with an HDL-32E. DIR/tuesday has scans of another day by an OS1-64, in
    autumn, with other cars, partly off monday's route. DIR/elsewhere.npy is a scan of another town.
    """
    from ...sample import load
    from ..io import write_scan
    from .results import check_folder

    check_folder(out)
    monday = _write(load("monday"), out / "monday", 1)
    tuesday = _write(load("tuesday"), out / "tuesday", TUESDAY_STEP)
    write_scan(out / "elsewhere.npy", load("elsewhere").scan(0).points)
    print(f"{out}: {monday} scans to map, {tuesday} to localize in the map. Next:")
    print(_COMMANDS.format(out=out), end="")


def _write(drive: SampleDrive, folder: Path, step: int) -> int:
    """Write every ``step``-th scan and its true pose, by number; return their count."""
    from ..io import Trajectory, write_scan, write_tum

    folder.mkdir(parents=True, exist_ok=True)
    indices = drive.indices[::step]
    with progress(folder.name) as update:
        for done, index in enumerate(indices):
            write_scan(folder / f"{index:06d}.npy", drive.scan(int(index)).points)
            update(done + 1, len(indices))
    write_tum(folder / "poses.tum", Trajectory(indices.astype(float), drive.truth[indices]))
    return len(indices)
