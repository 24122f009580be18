"""Scans and odometry to local clouds, segments and gravity."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..system import lazy

if TYPE_CHECKING:
    from .gravity import AttitudeEstimator as AttitudeEstimator
    from .local_cloud import Accumulator as Accumulator
    from .local_cloud import LocalCloudConfig as LocalCloudConfig
    from .local_cloud import window as window
    from .segmentation import Segmentation as Segmentation
    from .segmentation import SegmentationConfig as SegmentationConfig
    from .segmentation import Segmenter as Segmenter
else:
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "gravity": "AttitudeEstimator",
            "local_cloud": "Accumulator LocalCloudConfig window",
            "segmentation": "Segmentation SegmentationConfig Segmenter",
        },
    )
