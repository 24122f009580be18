"""Figures that were published, to stand beside what is measured here.

All are from Tinchev et al., "Real-time LIDAR localization in natural and urban environments"
(arXiv 2301.13583).
"""

from __future__ import annotations

METHODS = (
    "segmatch-eigen",
    "segmatch-esf",
    "nsm",
    "segmap",
    "esm",
    "esm-fq",
    "dsm",
    "dsm-fq",
)
"""By our names: there SM-Eig, SM-ESF, NSM-RF, SegMap, ESM, ESM-FQ, DSM, DSM-FQ."""

GENERALIZATION: tuple[tuple[str, str, tuple[float, ...]], ...] = (
    ("kitti", "kitti", (0.632, 0.655, 0.738, 0.858, 0.902, 0.930, 0.880, 0.911)),
    ("kitti", "burgess", (0.666, 0.711, 0.736, 0.764, 0.828, 0.888, 0.864, 0.920)),
    ("kitti", "robotcar", (0.680, 0.709, 0.752, 0.822, 0.873, 0.890, 0.807, 0.825)),
    ("burgess", "burgess", (0.685, 0.714, 0.753, 0.850, 0.836, 0.883, 0.815, 0.869)),
    ("burgess", "kitti", (0.626, 0.697, 0.713, 0.781, 0.817, 0.868, 0.797, 0.849)),
    ("burgess", "robotcar", (0.710, 0.730, 0.732, 0.808, 0.814, 0.853, 0.794, 0.839)),
    ("robotcar", "robotcar", (0.856, 0.880, 0.848, 0.953, 0.969, 0.972, 0.961, 0.967)),
    ("robotcar", "kitti", (0.760, 0.821, 0.815, 0.952, 0.934, 0.926, 0.928, 0.929)),
    ("robotcar", "burgess", (0.819, 0.853, 0.865, 0.951, 0.934, 0.948, 0.922, 0.938)),
)
"""Table I: test set, training set, and the area under the ROC of each of :data:`METHODS`."""
