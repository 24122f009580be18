"""SegMap's network: its size, its heads, and that inference computes what was trained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from samples.shapes import shapes_dataset  # noqa: E402
from segloc_lab.training.config import TrainConfig  # noqa: E402
from segloc_lab.training.segmap import SegMapNetwork  # noqa: E402
from segloc_lab.training.tasks import create_task  # noqa: E402
from segloc_lab.training.train import Batches  # noqa: E402

from segloc.descriptors.segmap import SegMapDescriptor  # noqa: E402

torch.set_num_threads(1)
CONFIG = TrainConfig(network="segmap", classes=4, learning_rate=1e-4)


def test_size_and_shapes() -> None:
    network = SegMapNetwork(11)
    assert network.trunk_parameters() == 8_591_552
    descriptor, logits, occupancy = network(torch.zeros(2, 32, 32, 16), torch.ones(2, 3))
    assert descriptor.shape == (2, 64) and (descriptor >= 0).all()
    assert logits.shape == (2, 11)
    assert occupancy.shape == (2, 32, 32, 16)


@pytest.mark.slow
def test_weights_for_inference_compute_the_same(tmp_path: Path) -> None:
    dataset = shapes_dataset(6, 2, seed=3)
    task = create_task(CONFIG)
    torch.manual_seed(0)
    network = task.network(6)
    batch = Batches(dataset, task).make(0)
    before = task.loss(network, batch)
    before.backward()  # also fills the running statistics of the norms
    assert torch.isfinite(before)
    assert all(p.grad is not None for p in network.parameters())
    network.eval()
    with torch.no_grad():
        grids, scales = task.inputs(dataset, np.arange(len(dataset)))
        expected = network.describe(grids, scales).numpy()
    native = task.describe(network, dataset)
    np.testing.assert_allclose(native, expected, atol=1e-4 * np.abs(expected).max())
    path = tmp_path / "segmap.safetensors"
    task.export(network, path, {"data": "shapes"})
    descriptor = SegMapDescriptor(path, threads=1)
    rounded = descriptor.describe(dataset.segments()).vectors
    assert descriptor.card["data"] == "shapes"
    np.testing.assert_allclose(rounded, expected, atol=0.05 * np.abs(expected).max())
