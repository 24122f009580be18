"""What robots did is counted as it was: kidnapped ones, streams, paths whose loops are closed."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from segloc_lab.peers.loops import ate, chained, tied
from segloc_lab.protocols import kidnapping, live_streams
from segloc_lab.protocols.kidnapping import Trial
from segloc_lab.protocols.live_streams import there_and_back

from segloc import geometry
from segloc.loops.graph import Edges


def trial(number: int, **more: object) -> Trial:
    told = {"way": "street", "known": True, "noticed": 3.0, "recovered": 12.0, "held": 3.0}
    given = {"seed": 8, "number": number, "scene": "town", "sensor": "hdl64e", "carried_on": 2.0}
    return Trial(**(given | told | more))  # type: ignore[arg-type]


def test_trials_are_read_once_and_counted_by_what_was_asked_of_them(tmp_path: Path) -> None:
    found = [
        trial(0),
        trial(1, noticed=None, recovered=None, held=40.0),
        trial(2, way="outside", recovered=None),
        trial(3, known=False, noticed=0.0),
    ]
    path = tmp_path / "trials.jsonl"
    path.write_text("".join(json.dumps(asdict(t)) + "\n" for t in (*found, found[0])))
    assert kidnapping.read([path, tmp_path / "none"]) == found
    row = dict(zip(kidnapping.COLUMNS, kidnapping.table(found)[-1], strict=True))
    assert (row["trials"], row["known before"]) == (4, 3)
    assert str(row["noticed within 30 m"]).startswith("2 of 3")
    assert str(row["recovered within 60 m"]).startswith("1 of 2")  # not where there is no map
    assert row["false for more than 5 m"] == 1 and row["noticed, median / worst (m)"] == "3 / never"


def test_a_stream_is_added_up_over_its_pieces() -> None:
    piece = {"stream": "s", "scans": 10, "covered": 5, "localized": 4, "false_m": 0.0}
    piece |= {"degraded_false_m": 1.0, "errors": [0.1], "scan_ms": [10.0] * 10, "query_ms": [50.0]}
    rows = live_streams.table([piece | {"first_fix": [3.0]}, piece | {"first_fix": [None]}])
    row = dict(zip(live_streams.COLUMNS, rows[0], strict=True))
    assert row["localized"] == "80.0 %" and row["first fix, median / 95 % (m)"] == "3 / never"
    assert row["share of a core at 10 Hz"] == "0.15" and row["degraded and false (m)"] == 2.0
    assert there_and_back(3, 6).tolist() == [0, 1, 2, 1, 0, 1]


def test_a_right_loop_takes_the_drift_out_of_a_path() -> None:
    turn = geometry.yaw_transform(2 * np.pi / 40, (2.0, 0.0, 0.0))
    truths = chained(np.tile(turn, (41, 1, 1)))
    wrong = geometry.yaw_transform(2 * np.pi / 40 + 0.003, (2.02, 0.0, 0.0))
    odometry = chained(np.tile(wrong, (41, 1, 1)))
    covariance = np.diag([1e-5] * 3 + [1e-2] * 3)[None]
    T = (geometry.inverse(truths[0]) @ truths[40])[None]
    loops = Edges(np.array([0]), np.array([40]), T, covariance)
    assert ate(truths @ geometry.yaw_transform(0.0), truths) == pytest.approx(0.0, abs=1e-9)
    assert ate(tied(odometry, loops), truths) < 0.5 * ate(odometry, truths)
