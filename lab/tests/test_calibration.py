"""The confidence that is shipped is the one that the stored candidates give."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from segloc_lab.calibration import reliability
from segloc_lab.calibration.reliability import fit, fit_cautious, joined

from segloc.likelihood import shipped_confidence
from segloc.likelihood.confidence import CAUTIOUS_FEATURES, FEATURES

ROWS = Path(reliability.__file__).parent


def test_weights_are_those_of_the_stored_candidates() -> None:
    first, alike = (np.load(ROWS / f"confidence-rows{name}.npz")["rows"] for name in ("", "-alike"))
    model = shipped_confidence()
    constant, *weights = fit(first)
    assert abs(constant - model.constant) < 0.25
    assert np.allclose(weights, [model.weights[name] for name in FEATURES], atol=0.1)
    constant, *weights = fit_cautious(joined([first, alike]))
    assert abs(constant - model.cautious.constant) < 0.25
    assert np.allclose(
        weights[: len(CAUTIOUS_FEATURES)],
        [model.cautious.weights[name] for name in CAUTIOUS_FEATURES],
        atol=0.1,
    )
    assert np.allclose(weights[len(CAUTIOUS_FEATURES) :], 0.0)  # of others they have none
