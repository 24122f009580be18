"""Run and score many queries, and draw the results."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...system import lazy

if TYPE_CHECKING:
    from .run import localize_sequence as localize_sequence
    from .run import query_clouds as query_clouds
    from .run import query_positions as query_positions
    from .score import COVERAGE_RADIUS_M as COVERAGE_RADIUS_M
    from .score import PATH_BREAK_M as PATH_BREAK_M
    from .score import Evaluation as Evaluation
    from .score import Tolerance as Tolerance
    from .score import distances_to_map as distances_to_map
    from .score import distances_to_path as distances_to_path
    from .score import pose_errors as pose_errors
else:
    __getattr__, __dir__ = lazy(
        __name__,
        {
            "run": "localize_sequence query_clouds query_positions",
            "score": "COVERAGE_RADIUS_M PATH_BREAK_M Evaluation Tolerance "
            "distances_to_map distances_to_path pose_errors",
        },
    )
