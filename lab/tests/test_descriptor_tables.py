"""Tables of descriptors apart from the pipeline, stored with the code that was scored."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from segloc_lab.protocols import descriptor_scores  # noqa: E402
from segloc_lab.results.fingerprints import fingerprints  # noqa: E402
from segloc_lab.results.store import Result  # noqa: E402
from segloc_lab.training.scoring import load_descriptor, score_descriptor  # noqa: E402
from segloc_lab.training.shapes import shapes_dataset  # noqa: E402
from segloc_lab.training.shards import load_dataset  # noqa: E402
from segloc_lab.weights import pair_head_study, quality_use  # noqa: E402

pytestmark = pytest.mark.torch


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two datasets of other objects."""
    folder = tmp_path_factory.mktemp("datasets")
    for seed, name in enumerate(("shapes", "others")):
        shapes_dataset(120, 3, seed=seed).save(folder / name)
    return folder / "shapes", folder / "others"


def stored(
    module: object, arguments: list[object], folder: Path, name: str, patch: pytest.MonkeyPatch
) -> Result:
    patch.setattr(sys, "argv", ["script", *map(str, arguments), "--store", str(folder)])
    module.main()  # type: ignore[attr-defined]
    return Result.load(folder / f"{name}.json")


def test_descriptors_side_by_side(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = [files[0], "--name", "ranks", "--methods", "geo", "dsm"]
    result = stored(descriptor_scores, given, tmp_path, "ranks", monkeypatch)
    report = score_descriptor(load_descriptor("dsm", 1), load_dataset(files[0]))
    geo, dsm = result.rows
    assert geo[0] == "geo" and dsm[:2] == ("dsm", str(report.auc))
    assert dsm[2:] == pytest.approx(report.recalls[0][1], abs=6e-4)
    assert list(dsm[2:]) == sorted(dsm[2:]) and "--name ranks --methods geo dsm" in result.command
    assert result.produced_by["weights of dsm"] == fingerprints((), ["dsm"])["weights of dsm"]

    given += ["--distractors", files[1], "--pool", 250, 500]
    result = stored(descriptor_scores, given, tmp_path, "ranks", monkeypatch)
    assert result.columns == ("method", "250 segments", "500 segments")
    assert all(0 < more <= fewer <= 1 for _, fewer, more in result.rows)


def test_what_fc4_is_worth(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = ["dsm", f"own={files[1]}:{files[0]}", f"other=:{files[1]}", "--seeds", 2]
    result = stored(pair_head_study, given, tmp_path, "fc4-dsm", monkeypatch)
    assert [row[:3] for row in result.rows] == [
        (head, source, test)
        for head, source in (("as it came", None), ("two_layer", "own"), ("two_layer", "all"))
        for test in ("own", "other")
    ]
    same = [row[3:] for row in result.rows[2:]]  # "all" is the one training set that there is
    assert same[:2] == same[2:] and 0.5 < result.rows[0][3] < 1  # type: ignore[operator]

    given = [files[0], "--methods", "dsm", "--k", 5]
    result = stored(quality_use, given, tmp_path, "fc4-order", monkeypatch)
    assert [row[1] for row in result.rows] == ["distance", "FC4", "distance and quality"]
    shares = {row[-1] for row in result.rows}
    assert len(shares) == 1  # of all candidates, in whatever order
    assert result.rows[0][3] == "+0.0000 (+0.0000 to +0.0000)"
