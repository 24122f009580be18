"""Studies on pairs of segments: labels, curves, trainings."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("sklearn")

from samples.shapes import shapes_dataset  # noqa: E402
from segloc_lab.bench.harness import Row  # noqa: E402
from segloc_lab.evaluation.study import Study, Table  # noqa: E402
from segloc_lab.studies.paper import domains as making  # noqa: E402
from segloc_lab.studies.paper import pairs as pair_module  # noqa: E402
from segloc_lab.studies.paper import (  # noqa: E402
    roc,
    sampling,
    transfer,
)
from segloc_lab.studies.paper.domains import SIMULATED, Domains, DomainSize  # noqa: E402
from segloc_lab.studies.paper.learning import Effort, Training, load_method, trained  # noqa: E402
from segloc_lab.studies.paper.pairs import labelled_pairs  # noqa: E402
from segloc_lab.studies.paper.transfer import TITLES  # noqa: E402
from segloc_lab.studies.paper.workspace import Workspace  # noqa: E402
from segloc_lab.training import pair_fitting  # noqa: E402
from segloc_lab.training.extract import Extract, sorted_extents  # noqa: E402
from segloc_lab.training.labels import LabelConfig  # noqa: E402
from segloc_lab.training.shards import Session, load_dataset, write_shard  # noqa: E402

from segloc.errors import ConfigError, DatasetError  # noqa: E402

SIZES = dict.fromkeys(SIMULATED, DomainSize(1, 1, "small"))
EFFORT = Effort({"dsm": 3, "esm": 1, "segmap": 1, "profile": 4}, 300, 2000)
PLAN = transfer.Plan(SIZES, EFFORT, 60)
METHODS = ("segmatch-eigen", "dsm", "dsm-fq", "geo")
OBJECTS, SESSIONS = 70, 5
SIMULATE = making._simulate


def shapes_session(job: Any) -> Session:
    """In the place of a session of a simulated world: objects 30 m apart."""
    seed = job.seed + 10 * SIMULATED.index(job.domain) + 5 * (job.split == "test")
    dataset = shapes_dataset(OBJECTS, SESSIONS, seed)
    own = dataset.subset(np.flatnonzero(dataset.sessions == job.session))
    labels = own.labels
    spots = 30.0 * np.column_stack([labels // 8, labels % 8, np.zeros(OBJECTS)])
    extents = [sorted_extents(own.segment(i)) for i in range(OBJECTS)]
    session = Session(f"{job.domain}-{job.split}-{job.seed}", f"session-{job.session}", "none")
    extract = Extract(
        own.points, own.offsets, spots + 0.1 * job.session, own.heights, np.array(extents),
        own.lengths, labels, np.zeros((1, 3), np.float32),
    )  # fmt: skip
    write_shard(job.folder, session, extract, "shapes")
    return session


@pytest.fixture(scope="module")
def patched() -> Iterator[pytest.MonkeyPatch]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(making, "_simulate", shapes_session)
        patch.setattr(pair_fitting, "STEPS", 20)
        label = LabelConfig(rule="centroids")  # the shapes are seen from one side only
        patch.setattr(making, "_EXTRACT", making._EXTRACT.model_copy(update={"label": label}))
        yield patch


@pytest.fixture(scope="module")
def space(patched: Any, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    return Workspace(tmp_path_factory.mktemp("evaluation"), methods=METHODS)


@pytest.fixture(scope="module")
def curves(space: Workspace) -> Study:
    return roc.run(space, PLAN)


def cells(table: Table, column: str, keys: int = 1) -> dict[Any, Any]:
    """A column by what the first columns say."""
    k = table.columns.index(column)
    return {row[0] if keys == 1 else row[:keys]: row[k] for row in table.rows}


def test_pairs_are_labelled_as_in_the_paper(space: Workspace) -> None:
    dataset = Domains(space, SIZES).dataset("kitti", "test")
    pairs = labelled_pairs(dataset, limit=50, seed=3)
    again = labelled_pairs(dataset, limit=50, seed=3)
    assert all(np.array_equal(getattr(pairs, f), getattr(again, f)) for f in ("first", "second"))
    assert pairs.same.sum() == (~pairs.same).sum() == 50
    a, b = pairs.first, pairs.second
    assert (dataset.sessions[a] != dataset.sessions[b]).all()
    apart = np.linalg.norm(dataset.centroids[a] - dataset.centroids[b], axis=1)
    assert (apart[pairs.same] < 0.5).all() and (apart[~pairs.same] > 20).all()
    everything = labelled_pairs(dataset)
    assert everything.same.sum() == OBJECTS  # each is in both sessions, once
    alone = dataset.subset(np.flatnonzero(dataset.sessions == 0))
    with pytest.raises(DatasetError, match="two sessions"):
        labelled_pairs(alone)
    together = dataset.subset(np.flatnonzero(dataset.labels == 0))
    with pytest.raises(DatasetError, match="20 m"):
        labelled_pairs(together)


def test_simulated_domains_hold_true_pairs(patched: pytest.MonkeyPatch, tmp_path: Path) -> None:
    size = DomainSize(1, 1, "small")
    with patched.context() as patch:
        patch.setattr(making, "_simulate", SIMULATE)
        folder = making.simulated(Workspace(tmp_path), "burgess", "train", size)
        dataset = load_dataset(folder)
        pairs = labelled_pairs(dataset)
        known = dataset.objects[pairs.first], dataset.objects[pairs.second]
        assert (known[0] == known[1])[pairs.same].mean() > 0.7
        assert (known[0] == known[1])[~pairs.same].mean() < 0.1
        (folder / "index.json").unlink()  # as if it had been cut off at the end
        making.simulated(Workspace(tmp_path), "burgess", "train", size)
    np.testing.assert_array_equal(load_dataset(folder).labels, dataset.labels)
    with pytest.raises(ConfigError, match="atlantis"):
        making.simulated(Workspace(tmp_path), "atlantis", "train", size)


def test_roc_study(curves: Study) -> None:
    areas = curves.tables[0]
    assert [row[0] for row in areas.rows] == list(METHODS)
    for domain in SIMULATED:
        values = cells(areas, TITLES[domain])
        assert values["geo"] > 0.8  # shapes of their own sizes
        assert all(0.3 < value <= 1 for value in values.values())


def test_every_kind_of_weights_is_trained_and_read(space: Workspace) -> None:
    data = Domains(space, SIZES).folder("kitti", "train")
    root = space.out / "models"
    wanted = [
        Training(method, data, EFFORT.config(method), root) for method in ("nsm", "esm", "segmap")
    ]
    dataset = load_dataset(data)
    few = labelled_pairs(dataset, limit=10)
    for training, path in zip(wanted, trained(space, wanted), strict=True):
        assert path == training.out and not path.with_suffix(".checkpoint").exists()
        descriptor = load_method(training.method, path)
        scores = pair_module.pair_scores(
            pair_module.described(descriptor, dataset, few), descriptor.pruner
        )
        assert scores.shape == (20,) and np.isfinite(scores).all()
    assert load_method("esm-fq", wanted[1].out).pruner is not None
    assert load_method("esm", wanted[1].out).rates


def test_sampling_study(space: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    row = Row("fps", 1, 2.0, {sampling.NAIVE: 800.0, "NumPy, batched": 400.0})
    monkeypatch.setattr(sampling, "in_process", lambda *_: row)
    study = sampling.run(space, sampling.Plan(1, 2, 100, 40, SIZES))
    speed, worth = study.tables
    assert [line[2:] for line in speed.rows] == [(400.0, 1.0), (2.0, 200.0), (1.0, 400.0)]
    assert [line[0] for line in worth.rows] == ["farthest", "random", "inverse density"]
    assert all(0 <= line[1] <= 1 and 0 <= line[3] <= 1 for line in worth.rows)
