"""Published figures, shown beside the measured ones.

All are from Tinchev et al., "Real-time LIDAR localization in natural and urban environments"
(arXiv 2301.13583).
"""

from __future__ import annotations

from ...evaluation.study import Table

METHODS = ("segmatch-eigen", "segmatch-esf", "nsm", "segmap", "esm", "esm-fq", "dsm", "dsm-fq")
"""Our names of SM-Eig, SM-ESF, NSM-RF, SegMap, ESM, ESM-FQ, DSM, DSM-FQ."""

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

LOCALIZATIONS: tuple[tuple[str, str, int, str, int, tuple[int | None, ...]], ...] = (
    ("robotcar", "Urban", 50310, "Push-broom", 1118, (80, 346, 915, 896, 773)),
    ("kitti", "Urban", 1300, "HDL-64E", 134, (41, 53, 62, 63, 62)),
    ("fire_college", "Industrial", 190, "VLP-16E", 169, (13, 12, 35, 45, 46)),
    ("george_square", "City park", 500, "Push-broom", 30, (8, 9, 8, 11, 10)),
    ("cornbury", "Forest", 700, "HDL-32E", 1125, (None, 29, 231, 248, 208)),
    ("burgess", "Forest", 2800, "Push-broom", 130, (41, 54, 95, 94, 90)),
)
"""Table II: name, type, metres, sensor, clouds, and the number of localizations of SegMatch, NSM,
SegMap, ESM and DSM."""

TIMES: tuple[tuple[str, str, str, tuple[int, ...], int, int], ...] = (
    ("several cores", "segmatch-esf", "7 (647)", (17, 0, 605, 50, 755, 64), 200, 1491),
    ("several cores", "nsm", "66", (17, 0, 24, 207, 913, 65), 200, 1226),
    ("several cores", "segmap", "64", (17, 15, 5902, 19, 0, 21), 25, 5974),
    ("several cores", "esm", "16", (17, 3, 578, 8, 0, 9), 25, 615),
    ("several cores", "dsm", "16", (17, 8, 184, 8, 0, 9), 25, 226),
    ("one core", "segmatch-esf", "7 (647)", (21, 0, 596, 70, 773, 64), 200, 1524),
    ("one core", "nsm", "66", (21, 0, 37, 213, 936, 65), 200, 1272),
    ("one core", "segmap", "64", (21, 26, 25945, 26, 0, 21), 25, 26039),
    ("one core", "esm", "16", (21, 3, 2126, 12, 0, 11), 25, 2173),
    ("one core", "dsm", "16", (21, 8, 731, 12, 0, 11), 25, 783),
    ("GPU", "segmap", "64", (17, 15, 15, 19, 0, 15), 25, 81),
    ("GPU", "esm", "16", (17, 3, 2, 8, 0, 6), 25, 36),
    ("GPU", "dsm", "16", (17, 8, 2, 8, 0, 6), 25, 41),
)
"""Table III: processor, method, numbers of a descriptor, milliseconds of segmentation,
preprocessing, descriptor, matching, pruning and pose, K, and the total as it was printed."""


def localizations() -> Table:
    """Return Table II."""
    return Table(
        "localizations-paper",
        "Number of localizations",
        ("set", "type", "metres", "sensor", "clouds", "SegMatch", "NSM", "SegMap", "ESM", "DSM"),
        tuple((*row[:5], *row[5]) for row in LOCALIZATIONS),
        "On the recordings themselves, which the simulated sets take after in kind, length and "
        "sensor: compare methods with each other, not numbers across the tables. How many clouds "
        "lie within map coverage is not published; there were no false localizations.",
        "paper",
    )


def times() -> Table:
    """Return Table III."""
    return Table(
        "times-paper",
        "Milliseconds a query",
        (
            "method", "processor", "numbers", "segmentation", "preprocessing", "descriptor",
            "matching", "K", "pruning", "pose", "total",
        ),
        tuple(
            (method, processor, size, *stages[:4], k, *stages[4:], total)
            for processor, method, size, stages, k, total in TIMES
        ),
        "Clouds of Burgess Field; mobile Xeon E3-1535M, and a Titan Xp. The size of the map and "
        "the number of segments are not published. Totals as printed.",
        "paper",
    )  # fmt: skip
