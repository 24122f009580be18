"""Training learns, resumes exactly, and exports what it trained."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from segloc.errors import DatasetError
from segloc.frontend.segmentation import Segmentation
from segloc.types import LocalCloud, Scan, Segments

torch = pytest.importorskip("torch")
pytest.importorskip("segloc_lab.training.train")

from segloc_lab.training import pair_fitting  # noqa: E402
from segloc_lab.training.config import AugmentConfig, HeadKind, TrainConfig, augment  # noqa: E402
from segloc_lab.training.dataset import SegmentDataset  # noqa: E402
from segloc_lab.training.extract import ExtractConfig, extract_session  # noqa: E402
from segloc_lab.training.labels import LabelConfig, label_objects  # noqa: E402
from segloc_lab.training.metrics import matching_pairs, nearest_is_right, score  # noqa: E402
from segloc_lab.training.pair_fitting import PairHead, fit_pair_head  # noqa: E402
from segloc_lab.training.pointset import prepared_points  # noqa: E402
from segloc_lab.training.shards import Session, finish, load_dataset, write_shard  # noqa: E402
from segloc_lab.training.train import train  # noqa: E402

from segloc.descriptors.pointset import PairHead as NumpyHead  # noqa: E402
from segloc.descriptors.pointset import load_weights  # noqa: E402
from segloc.tools.datasets.recorded import Selection  # noqa: E402

torch.set_num_threads(1)

QUICK = TrainConfig(
    steps=20, classes=12, validate_every=10, mine_every=10, warmup=5, validation_limit=60
)


def quiet(_: str) -> None:
    pass


@pytest.fixture
def quick_head(monkeypatch: pytest.MonkeyPatch) -> None:
    """FC4, fitted once the network is trained, takes longer than these few steps of training."""
    monkeypatch.setattr(pair_fitting, "STEPS", 20)


@pytest.mark.slow
@pytest.mark.usefixtures("quick_head")
def test_training_learns_and_exports(shapes: SegmentDataset, tmp_path: Path) -> None:
    out = tmp_path / "net.safetensors"
    before = train(shapes, tmp_path / "start.safetensors", QUICK.model_copy(update={"steps": 1}),
                   progress=quiet)  # fmt: skip
    after = train(shapes, out, QUICK, {"data": "shapes", "licence": "MIT"}, quiet)
    assert after.auc > 0.9
    assert after.auc > before.auc
    weights = load_weights(out)
    assert weights.card["data"] == "shapes"
    assert weights.card["figures"]["validation auc"] == round(after.auc, 4)
    _, validation = shapes.split(QUICK.validation_share, QUICK.seed)
    prepared = prepared_points(validation, np.arange(len(validation)), QUICK)
    vectors, quality = weights.network.describe(prepared)
    assert score(vectors, validation) == after
    assert ((quality > 0) & (quality < 1)).all()


@pytest.mark.slow
@pytest.mark.usefixtures("quick_head")
def test_a_run_that_was_cut_off_goes_on_exactly(shapes: SegmentDataset, tmp_path: Path) -> None:
    whole, parts = tmp_path / "whole.safetensors", tmp_path / "parts.safetensors"
    config = QUICK.model_copy(update={"hard_share": 0.5})
    train(shapes, whole, config, progress=quiet)
    # The learning rate follows the whole length: stop by time, not by fewer steps.
    train(shapes, parts, config.model_copy(update={"max_minutes": 1e-9}), progress=quiet)
    train(shapes, parts, config, progress=quiet)
    a, b = load_weights(whole), load_weights(parts)
    assert a.sha256 == b.sha256
    with pytest.raises(DatasetError, match="another configuration"):
        train(shapes, parts, config.model_copy(update={"seed": 1}), progress=quiet)
    more = dataclasses.replace(shapes, points=shapes.points * 1.01)
    with pytest.raises(DatasetError, match="on another dataset"):
        train(more, parts, config, progress=quiet)


@pytest.mark.slow
@pytest.mark.usefixtures("quick_head")
def test_a_run_that_ended_early_has_ended(shapes: SegmentDataset, tmp_path: Path) -> None:
    out, told = tmp_path / "net.safetensors", list[str]()
    config = QUICK.model_copy(update={"steps": 400, "patience": 1, "validate_every": 5})
    train(shapes, out, config, progress=told.append)
    assert not any("step 400" in line for line in told)
    first = out.read_bytes()
    for _ in range(2):
        told.clear()
        train(shapes, out, config, progress=told.append)
        assert not any(line.startswith("step ") for line in told)
        assert out.read_bytes() == first


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "nearest"), [("linear", False), ("two_layer", True)])
def test_fc4_finds_what_matters(kind: HeadKind, nearest: bool) -> None:
    """One of two numbers is noise: a fitted head separates pairs better than distance."""
    rng = np.random.default_rng(0)
    labels = np.repeat(np.arange(40), 3)
    useful = np.repeat(rng.normal(0, 3, 40), 3) + 0.1 * rng.normal(size=120)
    vectors = np.column_stack([useful, rng.normal(0, 3, 120)]).astype(np.float32)
    segments = SegmentDataset(
        np.zeros((120, 3), np.float32), np.arange(121), labels, np.arange(120) % 3,
        np.zeros(120, np.int64), 50.0 * labels[:, None] * [1.0, 0, 0], np.zeros(120, np.float32),
    )  # fmt: skip
    torch.manual_seed(0)
    head = PairHead(kind, 2)
    fit_pair_head(head, [(vectors, segments)], nearest=nearest)
    a, b = np.triu_indices(120, 1)
    same = labels[a] == labels[b]
    with torch.inference_mode():
        logits = head(torch.from_numpy(vectors[a]), torch.from_numpy(vectors[b])).numpy()
    distance = np.linalg.norm(vectors[a] - vectors[b], axis=1)

    def area(score: np.ndarray) -> float:
        return float((score[same][:, None] > score[~same]).mean())

    assert area(logits) > max(0.93, area(-distance) + 0.05)
    tensors = {name: tensor.numpy() for name, tensor in head.tensors().items()}
    native = NumpyHead(tensors, 2)
    index = np.arange(len(vectors))
    likely = native.probability(vectors, vectors[::-1], index, index)
    wanted = head(torch.from_numpy(vectors), torch.from_numpy(vectors[::-1].copy()))
    np.testing.assert_allclose(likely, torch.sigmoid(wanted).detach().numpy(), atol=1e-6)


def test_augmentation_keeps_what_it_must() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(300, 3)).astype(np.float32)
    for seed in range(6):
        changed = augment(points, AugmentConfig(), np.random.default_rng(seed))
        assert changed.dtype == np.float32
        assert 50 < len(changed) <= 300
        np.testing.assert_array_equal(
            changed, augment(points, AugmentConfig(), np.random.default_rng(seed))
        )
    few = augment(points[:21], AugmentConfig(drop=0.9, occlude=0.9), rng)
    assert len(few) >= 20
    still = AugmentConfig(yaw=False, drop=0, occlude=0, thin=0, noise_m=0)
    np.testing.assert_array_equal(augment(points, still, rng), points)


def test_scores_of_known_descriptors() -> None:
    n = 40
    labels = np.arange(n, dtype=np.int64) // 2
    sessions = np.arange(n, dtype=np.int64) % 2
    centroids = 100.0 * labels[:, None] * [1.0, 0, 0]
    dataset = SegmentDataset(
        np.zeros((n, 3), np.float32), np.arange(n + 1), labels, sessions,
        np.zeros(n, np.int64), centroids, np.zeros(n, np.float32),
    )  # fmt: skip
    perfect = labels[:, None].astype(np.float32)
    found = score(perfect, dataset, k=5)
    assert (found.auc, found.recall, found.recall_first) == (1.0, 1.0, 1.0)
    assert nearest_is_right(perfect, dataset).all()
    random = np.random.default_rng(0).normal(size=(n, 3)).astype(np.float32)
    assert (score(random, dataset, k=5).recall or 1.0) < 0.7
    alone = score(perfect, replace(dataset, sessions=np.zeros(n, np.int64)), k=5)
    assert alone.recall is None and "two sessions" in str(alone)
    a, b = matching_pairs(dataset)
    assert len(a) == n // 2
    assert (labels[a] == labels[b]).all() and (sessions[a] != sessions[b]).all()


def test_dataset_file(tmp_path: Path, shapes: SegmentDataset) -> None:
    path = tmp_path / "set.safetensors"
    shapes.save(path)
    again = SegmentDataset.load(path)
    np.testing.assert_array_equal(again.points, shapes.points)
    np.testing.assert_array_equal(again.labels, shapes.labels)
    both = SegmentDataset.concatenate([shapes, again])
    assert len(both) == 2 * len(shapes)
    assert len(np.unique(both.labels)) == 2 * len(np.unique(shapes.labels))
    np.testing.assert_array_equal(both.segment(len(shapes) + 3), shapes.segment(3))
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(DatasetError, match=r"set\.safetensors"):
        SegmentDataset.load(path)


class Street:
    """A recording of poles and boxes along a line; each scan shows what is near."""

    def __init__(self, session: int, shift: float) -> None:
        rng = np.random.default_rng(3)
        objects = [
            rng.uniform(-1, 1, (60, 3)) * rng.uniform(0.3, 2.0, 3)
            + [8.0 * i, rng.choice([-6, 6]), 2]
            for i in range(20)
        ]
        self.cloud = np.concatenate(objects)
        self.name = f"street {session}"
        self.indices = np.arange(40, dtype=np.int64)
        self.stamps = None
        self.poses = np.tile(np.eye(4), (40, 1, 1))
        self.poses[:, 0, 3] = 4.0 * np.arange(40)
        self.poses[:, 1, 3] = shift

    def __len__(self) -> int:
        return len(self.indices)

    def scan(self, i: int) -> Scan:
        points = self.cloud - self.poses[i, :3, 3]
        return Scan(points[np.abs(points[:, 0]) < 20], T_odom_sensor=self.poses[i])

    def select(self, selection: Selection) -> Street:
        raise NotImplementedError


def by_cell(cloud: LocalCloud) -> Segmentation:
    """Segments of 8 m along the street of the objects that are fully seen."""
    points = np.unique(cloud.points.round(2), axis=0)
    order = np.argsort(points[:, 0], kind="stable")
    points = points[order]
    parts = np.split(points, np.flatnonzero(np.diff(points[:, 0]) > 1.5) + 1)
    parts = [part for part in parts if len(part) == 60]
    offsets = np.cumsum([0, *(len(part) for part in parts)], dtype=np.int64)
    centroids = np.array([part.mean(axis=0) for part in parts], np.float64).reshape(-1, 3)
    flat = np.concatenate([np.empty((0, 3)), *parts]).astype(np.float32)
    segments = Segments(flat, offsets, centroids, np.zeros(len(parts), np.float32))
    return Segmentation(segments, flat, np.empty((0, 3), np.float32))


def nothing(cloud: LocalCloud) -> Segmentation:
    return by_cell(LocalCloud(np.empty((0, 3), np.float32), np.eye(4)))


def test_extraction_labels_objects_across_sessions(tmp_path: Path) -> None:
    config = ExtractConfig(lengths_m=(16.0,), every_m=8.0)
    sessions = [Session("street", f"{k}", "eye") for k in range(2)]
    for session, shift in zip(sessions, (0.0, 0.4), strict=True):
        extract = extract_session(Street(int(session.name), shift), by_cell, config)
        write_shard(tmp_path, session, extract, "as ever")
    counts = finish(tmp_path, sessions, config.label)
    dataset = load_dataset(tmp_path)
    assert counts.segments == len(dataset)
    assert counts.matching_across > 10
    for label in np.unique(dataset.labels):
        members = np.flatnonzero(dataset.labels == label)
        assert np.ptp(dataset.centroids[members], axis=0).max() < 0.5
        assert set(dataset.sessions[members]) == {0, 1}
    assert 10 <= len(np.unique(dataset.labels)) <= 20
    assert dataset.different(np.array([0]), np.flatnonzero(dataset.centroids[:, 0] > 60)).all()
    with pytest.raises(DatasetError, match="no segment"):
        extract_session(Street(0, 0.0), nothing, config)


def test_labels_do_not_chain() -> None:
    """Centroids that creep along a wall are not all one object."""
    centroids = np.column_stack([0.4 * np.arange(50), np.zeros(50), np.zeros(50)])
    extents = np.tile([0.3, 2.0, 5.0], (50, 1))
    labels = label_objects(centroids, extents, LabelConfig())
    for label in np.unique(labels):
        assert np.ptp(centroids[labels == label, 0]) <= 1.0
    extents[::2] *= 3
    labels = label_objects(centroids, extents, LabelConfig())
    assert len(np.intersect1d(labels[::2], labels[1::2])) == 0


def test_validation_gets_places_that_were_visited_twice() -> None:
    rng = np.random.default_rng(0)
    n = 400
    labels = np.arange(n) // 2
    places = np.where(labels < 150, 0, 1)  # place 1 was visited once

    def dataset(places: np.ndarray, sessions: np.ndarray) -> SegmentDataset:
        return SegmentDataset(
            points=np.zeros((n, 3), np.float32),
            offsets=np.arange(n + 1),
            labels=labels,
            sessions=sessions,
            places=places,
            centroids=np.repeat(rng.uniform(0, 500, (n // 2, 3)), 2, axis=0),
            heights=np.zeros(n, np.float32),
        )

    once = dataset(places, np.where(places == 0, np.arange(n) % 2, 2))
    training, held = once.split(0.2, 0)
    assert set(held.places) == {0} and len(np.unique(held.sessions)) == 2
    assert not set(training.labels) & set(held.labels)
    assert len(training) + len(held) == n
    many = dataset(labels % 8, labels % 8 * 2 + np.arange(n) % 2)
    training, held = many.split(0.25, 0)
    assert len(np.unique(held.places)) == 2
    assert not set(training.places) & set(held.places)
