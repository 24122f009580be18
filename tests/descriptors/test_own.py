"""Weights of one's own, and descriptors of other packages, from the command line too."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from typer.testing import CliRunner

from segloc import Localizer, MapMismatch, SegmentMap
from segloc.cli import app
from segloc.descriptors import create
from segloc.descriptors.weightfile import read_weights, shipped_weights, write_weights
from segloc.io import Trajectory, write_tum
from segloc.io.scans import write_scan

PLUGIN = """
import numpy as np
from segloc.descriptors.base import Descriptor
from segloc.types import Descriptors

class Boxes(Descriptor):
    preset = {"matching": {"neighbours": 50}}
    name, dim, fingerprint = "boxes", 2, "boxes-1"

    def __init__(self, threads=0):
        pass

    def encode(self, segments):
        spans = [np.ptp(segments.segment(k), axis=0) for k in range(len(segments))]
        rows = [(span[2], np.hypot(*span[:2])) for span in spans]
        return Descriptors(np.array(rows, np.float32).reshape(-1, 2))
"""


@pytest.fixture
def recording(plaza: Plaza, tmp_path: Path) -> Path:
    """A walk on disk, with poses."""
    folder, walk = tmp_path / "walk", PlazaSequence(plaza, steps=4)
    folder.mkdir()
    for i in range(len(walk)):
        write_scan(folder / f"{i:04d}.npy", walk.scan(i).points)
    write_tum(folder / "poses.tum", Trajectory(np.arange(4.0), walk.poses))
    return folder


def retrained(path: Path) -> Path:
    """Weights that nobody ships: the profile network, a little shaken."""
    file = read_weights(shipped_weights("profile.safetensors"), "profile network")
    rng = np.random.default_rng(0)
    tensors = {k: v + rng.normal(0, 1e-3, v.shape).astype(v.dtype) for k, v in file.tensors.items()}
    write_weights(path, "profile network", tensors, file.settings, {"data": "a test"})
    return path


@pytest.mark.slow
def test_trained_weights_can_be_used(recording: Path, tmp_path: Path) -> None:
    weights = retrained(tmp_path / "mine.safetensors")
    run, site = CliRunner(), str(tmp_path / "site.segmap")
    build = ["map", "build", str(recording), "--poses", "poses.tum", "--out", site]
    done = run.invoke(app, [*build, "--weights", str(weights)])
    assert done.exit_code == 0, done.output
    prior_map = SegmentMap.load(site)
    assert prior_map.fingerprint != create("profile").fingerprint
    assert Localizer(prior_map).config.weights == weights
    localize = ["localize", str(recording), "--map", site, "--out", str(tmp_path / "out")]
    assert run.invoke(app, localize).exit_code == 0  # by the weights that the map was built with
    weights.rename(tmp_path / "moved.safetensors")
    done = run.invoke(app, localize)
    assert done.exit_code == 1 and "mine.safetensors" in str(done.exception)
    moved = ["--weights", str(tmp_path / "moved.safetensors")]
    assert run.invoke(app, [*localize, *moved]).exit_code == 0
    done = run.invoke(app, [*localize, "--weights", str(shipped_weights("profile.safetensors"))])
    assert isinstance(done.exception, MapMismatch) and "weights" in str(done.exception)


@pytest.mark.slow
def test_a_descriptor_of_another_package_is_found(recording: Path, tmp_path: Path) -> None:
    package = tmp_path / "packages"
    info = package / "boxes_descriptor-1.0.dist-info"
    info.mkdir(parents=True)
    (package / "boxes_descriptor.py").write_text(PLUGIN)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: boxes-descriptor\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[segloc.descriptors]\nboxes = boxes_descriptor:Boxes\nbroken = nonesuch:Factory\n"
    )
    path = os.pathsep.join([str(package), *filter(None, sys.path)])
    command = "from segloc.cli import main; main()"

    def segloc(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", command, *arguments],
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=False,
        )

    site, out = str(tmp_path / "site.segmap"), tmp_path / "out"
    build = ["map", "build", str(recording), "--poses", "poses.tum", "--out", site]
    done = segloc(*build, "--method", "boxes")
    assert done.returncode == 0, done.stderr
    assert SegmentMap.load(site).fingerprint == "boxes-1"
    done = segloc("localize", str(recording), "--map", site, "--out", str(out))
    assert done.returncode == 0, done.stderr
    lines = (out / "localizations.jsonl").read_text().splitlines()
    assert any(json.loads(line)["localized"] for line in lines)
    done = segloc(*build, "--method", "broken")
    assert done.returncode == 1 and "'broken' cannot be loaded" in done.stderr
    assert "Traceback" not in done.stderr
