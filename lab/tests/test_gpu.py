"""The measurements for a GPU, tried on the CPU at their smallest."""

from __future__ import annotations

import os

import pytest
from segloc_lab.protocols import gpu
from segloc_lab.studies.paper.gpu import GPU_METHODS


def test_inference_and_a_training_become_results(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch")
    monkeypatch.setattr(gpu, "in_process", lambda threads, work, *given: work(*given))
    found = gpu.inference(3, 1, "cpu")
    where = len({1, os.cpu_count()}) + 1
    assert [row[0] for row in found.rows] == [m for m in GPU_METHODS for _ in range(where)]
    assert all(row[2] + row[3] == pytest.approx(row[4], abs=0.02) for row in found.rows)
    trained = gpu.training(60, 0.04, "cpu")
    ((on, products, steps, seconds, _, area, _, peak),) = trained.rows
    assert "CPU" in str(on) and products == "float32" and steps >= 1 and seconds > 0
    assert 0.5 < area <= 1 and peak is None
    assert set(trained.produced_by) == {"descriptors", "training"}
