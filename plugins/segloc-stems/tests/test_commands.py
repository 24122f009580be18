"""The verbs that the entry point adds: a map of stems, and scans found in it."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from samples import stems

from segloc.tools.cli import main
from segloc.tools.io import Trajectory, write_tum


def recorded(folder: Path, places: list[tuple[float, float, float]], seed: int) -> Path:
    """Write single scans of a stand, with their poses."""
    stand = stems.stand(3, 300)
    poses = [stems.pose(*place) for place in places]
    (folder / "scans").mkdir(parents=True)
    for k, T in enumerate(poses):
        np.save(folder / "scans" / f"{k:04d}.npy", stems.visible(stems.cylinders(stand), stand, T))
    write_tum(folder / "poses.tum", Trajectory(np.arange(len(poses), dtype=float), np.stack(poses)))
    return folder / "scans"


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """Return what the command line prints."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sys, "argv", ["segloc", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
    printed = capsys.readouterr()
    assert not end.value.code, printed.err
    return printed.out


@pytest.mark.slow
def test_scans_are_found_in_a_map_of_stems(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = recorded(tmp_path / "drive", [(30.0 + 3 * k, 40.0, 0.1 * k) for k in range(6)], 0)
    later = recorded(tmp_path / "later", [(37.0, 42.0, 2.0), (41.0, 38.5, -1.0)], 50)
    site = tmp_path / "forest.segmap"
    run(capsys, "stems", "map", drive, "--poses", tmp_path / "drive/poses.tum", "--out", site)
    printed = run(capsys, "stems", "localize", later, "--map", site)
    assert "localized: 2 of 2" in printed
    found = re.findall(r"x (-?[\d.]+), y (-?[\d.]+)", printed)
    np.testing.assert_allclose(np.array(found, float), [(37.0, 42.0), (41.0, 38.5)], atol=0.3)
