"""Forests over pairs: native against scikit-learn, files, training, and pruning in the pipeline."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samples.shapes import shapes_dataset
from segloc_lab.training.grow_forest import ForestConfig, train_forest, trees_of
from segloc_lab.training.writing import write_forest

from segloc import _native
from segloc.descriptors.random_forest import (
    ForestDescriptor,
    Layout,
    PairForest,
    Trees,
)
from segloc.descriptors.weightfile import read_weights, write_weights
from segloc.errors import ConfigError, WeightsError
from segloc.map.segment_map import SegmentMap
from segloc.proposals.matching import Matcher, MatchingConfig
from segloc.types import Descriptors

INTEGERS = ("roots", "feature", "first_child")

STUMP = Trees(
    roots=np.array([0], np.int32),
    feature=np.array([0, 0, 0], np.int32),
    threshold=np.array([0.5, 0.9, 0.1], np.float32),
    first_child=np.array([1, -1, -1], np.int32),
)
"""Pairs whose first values differ by 0.5 at most are the same with probability 0.9."""


@pytest.mark.slow
@pytest.mark.parametrize("depth", [1, 5, 12])
def test_equals_scikit_learn(depth: int) -> None:
    ensemble = pytest.importorskip("sklearn.ensemble")
    rng = np.random.default_rng(depth)
    x = rng.normal(size=(3000, 9)).astype(np.float32).round(1)  # many values on a threshold
    y = x[:, 0] * x[:, 1] + rng.normal(0, 0.3, 3000) > 0
    model = ensemble.RandomForestClassifier(7, max_depth=depth, random_state=0).fit(x, y)
    trees = trees_of([estimator.tree_ for estimator in model.estimators_])
    forest = _native.Forest(**trees.arrays(), features=9)
    expected = model.predict_proba(x)[:, 1]
    np.testing.assert_allclose(forest.predict(x, threads=1), expected, atol=1e-6)
    np.testing.assert_array_equal(forest.predict(x, threads=2), forest.predict(x, threads=1))


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.integers(0, 7), st.booleans(), st.sampled_from([0, 4, 64]))
def test_features_of_pairs(seed: int, plain: int, ratios: bool, histogram: int) -> None:
    rng = np.random.default_rng(seed)
    dim = plain + 3 * histogram
    if dim == 0:
        return
    layout = Layout(plain, ratios, histogram)
    query, prior_map = (rng.normal(size=(n, dim)).astype(np.float32) for n in (5, 8))
    prior_map[0] = 0
    rows, columns = rng.integers(5, size=40), rng.integers(8, size=40)
    a, b = query[rows], prior_map[columns]
    d, p, q = abs(a - b)[:, :plain], abs(a)[:, :plain], abs(b)[:, :plain]
    expected = [d]
    if ratios:
        relative = [np.divide(d, r, out=np.zeros_like(d), where=r > 0) for r in (q, p)]
        expected += [*relative, p, q]
    if histogram:
        bins = np.minimum(a, b)[:, plain:].reshape(40, 3, histogram)
        expected.append(bins.sum(axis=2))
    ours = _native.pair_features(query, prior_map, rows, columns, layout.row)
    assert ours.shape == (40, layout.features(dim))
    np.testing.assert_allclose(ours, np.concatenate(expected, axis=1), rtol=1e-5, atol=1e-5)


class Plain(ForestDescriptor):
    name = "plain"
    dim = 1
    fingerprint = "plain-1"
    layout = Layout(1)

    def encode(self, prepared: object) -> Descriptors:
        raise NotImplementedError


def test_a_file_keeps_the_forest(tmp_path: Path) -> None:
    path = tmp_path / "f.safetensors"
    write_forest(path, STUMP, Plain.layout, Plain.fingerprint, {"data": "none"})
    forest = PairForest.load(path, Plain())
    assert forest.card == {"data": "none"}
    query, prior_map = np.array([[1.0]], np.float32), np.array([[1.4], [1.6]], np.float32)
    pairs = np.array([0, 0]), np.array([0, 1])
    np.testing.assert_allclose(forest.probability(query, prior_map, *pairs), [0.9, 0.1])
    with pytest.raises(WeightsError, match="no such file"):
        PairForest.load(tmp_path / "none", Plain())


def test_without_its_forest_a_method_describes_and_says_what_to_install() -> None:
    plain = Plain()
    with pytest.raises(WeightsError, match=r"plain-forest.* segloc-lab: .*pip install"):
        _ = plain.pruner


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "f.safetensors"
    write_forest(path, STUMP, Plain.layout, Plain.fingerprint, {})
    stored = STUMP.arrays()
    settings = {"descriptor": "plain-1", "layout": '{"plain": 1}'}

    def refused(fault: str, kind: str = "forest", **changes: str) -> None:
        write_weights(path, kind, stored, {**settings, **changes}, {})
        with pytest.raises(WeightsError, match=fault) as error:
            PairForest.load(path, Plain())
        assert str(path) in str(error.value)

    refused("not a forest", kind="network")
    refused("made for other-1", descriptor="other-1")
    refused("unexpected keyword", layout='{"bins": 3}')
    refused("Expecting value", layout="")
    stored["roots"] = np.array([9], np.int32)
    refused("root")
    stored["roots"] = np.array([0], np.int64)
    refused("expected int32")
    del stored["roots"]
    refused("roots")


def test_training_learns_and_repeats(tmp_path: Path) -> None:
    pytest.importorskip("sklearn")
    dataset = shapes_dataset(100, 3, seed=0)
    config = ForestConfig(trees=5, max_leaves=32, neighbours=40)
    files = [tmp_path / f"{k}.safetensors" for k in range(2)]
    scores = [train_forest(dataset, file, "nsm", config, progress=lambda _: None) for file in files]
    assert scores[0].auc > 0.7 and scores[0] == scores[1]
    assert scores[0].right_kept > scores[0].wrong_kept
    integers = dict.fromkeys(INTEGERS, np.int32)
    first, again = (read_weights(file, "forest", integers) for file in files)
    assert first.sha256 == again.sha256
    assert first.card == again.card and first.card["config"]["trees"] == 5
    with pytest.raises(ConfigError, match="geo has no forest"):
        train_forest(dataset, files[0], "geo", config)


def test_pruning_keeps_the_likely_matches_in_falling_order() -> None:
    prior_map = SegmentMap.empty("plain", "plain-1", 1)
    vectors = np.array([[0.0], [0.45], [3.0]], np.float32)
    prior_map.add(
        Descriptors(vectors),
        np.zeros((3, 3)),
        np.ones(3, int),
        session=0,
        stamp=0.0,
        cloud=np.zeros((1, 3)),
    )
    config = MatchingConfig(neighbours=3, min_probability=0.5)
    query = Descriptors(np.array([[0.2], [2.0]], np.float32))
    matcher = Matcher(prior_map, config, pruner=PairForest(STUMP, Plain.layout, 1))
    candidates = matcher.match(query)
    kept = matcher.prune(query, candidates)
    assert sorted(zip(kept.query.tolist(), kept.map.tolist(), strict=True)) == [(0, 0), (0, 1)]
    np.testing.assert_allclose(kept.score, 0.9)
    assert Matcher(prior_map, config).prune(query, candidates) is candidates
