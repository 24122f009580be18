"""The dataset that several tests train on."""

from __future__ import annotations

import pytest
from samples.shapes import shapes_dataset
from segloc_lab.training.dataset import SegmentDataset


@pytest.fixture(scope="session")
def shapes() -> SegmentDataset:
    return shapes_dataset(60, 3, seed=7)
