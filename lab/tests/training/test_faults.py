"""Errors of training for unusable settings, states and datasets."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from segloc.errors import ConfigError, DatasetError, SeglocError, WeightsError

torch = pytest.importorskip("torch")

from samples.shapes import shapes_dataset  # noqa: E402
from segloc_lab.training.config import TrainConfig, load_train_config  # noqa: E402
from segloc_lab.training.dataset import SegmentDataset  # noqa: E402
from segloc_lab.training.extract import Extract  # noqa: E402
from segloc_lab.training.labels import LabelConfig  # noqa: E402
from segloc_lab.training.metrics import load_descriptor  # noqa: E402
from segloc_lab.training.shards import INDEX, Session, load_dataset, write_shard  # noqa: E402
from segloc_lab.training.shards import finish as finish_dataset  # noqa: E402
from segloc_lab.training.train import _agrees, train  # noqa: E402

torch.set_num_threads(1)

QUICK = TrainConfig(
    network="profile", steps=4, classes=12, validate_every=2, warmup=2, validation_limit=60
)


def quiet(_: str) -> None:
    pass


def test_too_little_data(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="objects with two views"):
        train(shapes_dataset(5, 2, 0), tmp_path / "x.safetensors", QUICK, progress=quiet)


def test_an_older_checkpoint_goes_on_where_new_settings_have_their_defaults() -> None:
    saved = QUICK.model_dump(mode="json", exclude={"across", "steps"})
    assert _agrees(json.dumps(saved), QUICK)
    assert not _agrees(json.dumps({**saved, "classes": 13}), QUICK)
    assert not _agrees(json.dumps({**saved, "forgotten": 1}), QUICK)


@pytest.mark.slow
def test_a_state_that_is_not_of_this_run_is_refused(
    shapes: SegmentDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, state = tmp_path / "a.safetensors", tmp_path / "a.checkpoint"
    train(shapes, out, QUICK, progress=quiet)
    monkeypatch.setattr("segloc_lab.training.profile.WIDTHS", (16, 16))
    with pytest.raises(
        DatasetError, match=r"a\.checkpoint: not the state of this run .*ProfileNetwork"
    ):
        train(shapes, out, QUICK, progress=quiet)
    for content in (b"", b"nonsense", state.read_bytes()[:-200]):
        state.write_bytes(content)
        with pytest.raises(DatasetError, match=r"^.*a\.checkpoint: .*; remove it"):
            train(shapes, out, QUICK, progress=quiet)


def test_a_state_that_cannot_be_written(shapes: SegmentDataset, tmp_path: Path) -> None:
    (tmp_path / "a.checkpoint").mkdir()
    with pytest.raises(SeglocError, match=r"a\.checkpoint"):
        train(shapes, tmp_path / "a.safetensors", QUICK, progress=quiet)


def test_a_run_that_diverges_ends(shapes: SegmentDataset, tmp_path: Path) -> None:
    config = QUICK.model_copy(update={"network": "dsm", "learning_rate": 1e30, "warmup": 0})
    with pytest.raises(ConfigError, match="at step 2; try a smaller"):
        train(shapes, tmp_path / "a.safetensors", config, progress=quiet)


def test_settings_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "train.yaml"
    with pytest.raises(ConfigError, match=r"train\.yaml: cannot be read \(No such file"):
        load_train_config(path, {})
    for text, fault in (("a: [", "not YAML"), ("- 1", "mapping"), ("1: 2", "strings")):
        path.write_text(text)
        with pytest.raises(ConfigError, match=rf"train\.yaml: .*{fault}"):
            load_train_config(path, {})
    path.write_text("network: [a]")
    with pytest.raises(ConfigError, match="network"):
        load_train_config(path, {})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A dataset of one shard with two segments."""
    rng = np.random.default_rng(0)
    extract = Extract(
        rng.normal(size=(60, 3)).astype(np.float32),
        np.array([0, 30, 60]),
        np.zeros((2, 3)),
        np.ones(2, np.float32),
        np.ones((2, 3)),
        np.zeros(2, np.float32),
        np.full(2, -1),
        np.empty((0, 3), np.float32),
    )
    session = Session("place", "a", "eye")
    write_shard(tmp_path / "data", session, extract, "x")
    finish_dataset(tmp_path / "data", [session], LabelConfig())
    assert len(load_dataset(tmp_path / "data")) == 2
    return tmp_path / "data"


@pytest.mark.parametrize(
    "index",
    [
        "[1]",
        "{",
        "{}",
        '{"version": 1}',
        '{"version": 1, "sessions": [3]}',
        '{"version": 1, "sessions": [{"place": "a", "name": "b", "sensor": 3}]}',
        '{"version": 1, "sessions": [{"place": "a", "name": "../b", "sensor": "c"}]}',
    ],
)
def test_a_damaged_index(folder: Path, index: str) -> None:
    (folder / INDEX).write_text(index)
    with pytest.raises(DatasetError, match=INDEX):
        load_dataset(folder)


def test_a_damaged_shard(folder: Path, tmp_path: Path) -> None:
    (shard,) = folder.glob("*--*")
    whole = shard.read_bytes()
    for content in (b"", whole[:100], whole[:-20], whole.replace(b'"lengths"', b'"lengthy"')):
        shard.write_bytes(content)
        with pytest.raises(DatasetError, match=shard.name):
            load_dataset(folder)
    shard.write_bytes(whole)
    shutil.copy(shard, folder / "labels.safetensors")
    with pytest.raises(DatasetError, match="labels are missing"):
        load_dataset(folder)


def test_no_weights(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "text").write_text("no weights")
    for name, fault in (
        (folder, "directory"),
        (tmp_path / "text", "header"),
        ("x", "neither"),
    ):
        with pytest.raises(WeightsError, match=fault):
            load_descriptor(str(name))
