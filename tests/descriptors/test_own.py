"""Weights of one's own, and descriptors of other packages, from the command line too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from samples.walk import as_folder
from typer.testing import CliRunner

from segloc import Localizer, MapMismatch, SegmentMap
from segloc.descriptors import create
from segloc.descriptors.weightfile import read_weights, shipped_weights, write_weights
from segloc.tools.cli import app


@pytest.fixture
def recording(plaza: Plaza, tmp_path: Path) -> Path:
    """A walk on disk, with poses."""
    return as_folder(tmp_path / "walk", PlazaSequence(plaza, steps=4))


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
