"""Tables of descriptors apart from the pipeline."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from segloc_lab.protocols import descriptor_scores  # noqa: E402
from segloc_lab.training.metrics import load_descriptor, score_descriptor  # noqa: E402
from segloc_lab.training.shapes import shapes_dataset  # noqa: E402
from segloc_lab.training.shards import load_dataset  # noqa: E402

pytestmark = pytest.mark.torch


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two datasets of other objects."""
    folder = tmp_path_factory.mktemp("datasets")
    for seed, name in enumerate(("shapes", "others")):
        shapes_dataset(120, 3, seed=seed).save(folder / name)
    return folder / "shapes", folder / "others"


def test_descriptors_side_by_side(
    files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    reports = descriptor_scores.scored(["geo", "dsm"], load_dataset(files[0]), [], [])
    columns, (geo, dsm) = descriptor_scores.by_rank(reports)
    report = score_descriptor(load_descriptor("dsm", 1), load_dataset(files[0]))
    assert geo[0] == "geo" and dsm[:2] == ("dsm", str(report.auc)) and len(columns) == len(dsm)
    assert dsm[2:] == pytest.approx(report.recalls[0][1], abs=6e-4)
    assert list(dsm[2:]) == sorted(dsm[2:])

    folder = files[0].parent / "report"
    given = [files[0], "--methods", "geo", "dsm", "--distractors", files[1], "--pool", 250, 500]
    monkeypatch.setattr(sys, "argv", ["script", *map(str, given), "--report", str(folder)])
    descriptor_scores.main()
    (table,) = json.loads((folder / "rows.json").read_text())
    assert table["columns"] == ["method", "250 segments", "500 segments"]
    assert all(0 < more <= fewer <= 1 for _, fewer, more in table["rows"])
