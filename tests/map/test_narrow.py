"""Maps of sensors with a narrow field of view."""

from __future__ import annotations

import numpy as np
import pytest
from samples.walk import Walk

from segloc import Config, Localizer
from segloc.map.build import (
    NARROW_SEGMENTATION,
    NARROW_VIEWS,
    adapted_to_view,
    build_map,
)
from segloc.types import Float64


def in_view(points: Float64) -> Float64:
    """What a sensor that sees 120 degrees has of a scan."""
    return points[np.abs(np.arctan2(points[:, 1], points[:, 0])) < np.radians(60)]


def test_settings_follow_the_field_of_view_where_they_have_their_defaults() -> None:
    full, narrow, config = Walk(), Walk(in_view), Config()
    adapted = adapted_to_view(config, [narrow])
    assert adapted.mapping.views == NARROW_VIEWS
    assert adapted.segmentation == NARROW_SEGMENTATION
    assert adapted_to_view(config, [full]) is config
    assert adapted_to_view(config, [narrow, full]) is config
    chosen = config.model_copy(
        update={"mapping": config.mapping.model_copy(update={"views": config.mapping.views[:1]})}
    )
    assert adapted_to_view(chosen, [narrow]) is chosen


@pytest.mark.slow
def test_queries_in_a_map_of_a_narrow_sensor_are_segmented_like_it() -> None:
    localizer = Localizer(build_map(Walk(in_view), Config()))
    assert localizer.config.segmentation == NARROW_SEGMENTATION
