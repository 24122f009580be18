"""What is flagged in the output of a reported input."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from segloc_lab.protocols.reported_inputs import Case, run_case

RUN = """
echo '$ segloc info good'; echo 'good: 3 scans'; echo '-> status 0'
echo '$ segloc info odd/right'; echo 'segloc: error: odd'; echo '-> status 1'
echo '### faulty'; echo 'no problems found'; echo 'status 0'
echo '### noted'; echo 'segloc: note: 1 point is left out'; echo 'status 0'
echo '### broken'; echo '  File "a.py", line 3, in f'; echo 'status 1'
echo '### far'; echo 'note: OK: localized | 27.1 m off'; echo 'status 0'
echo '### hangs'; echo 'note: reading'; echo '-> status 137'
"""


@pytest.mark.skipif(sys.platform != "linux", reason="times processes as Linux lists them")
def test_what_must_not_happen_is_flagged(tmp_path: Path) -> None:
    (tmp_path / "run.sh").write_text(RUN)
    cases = {case.name: case.flags() for case in run_case(tmp_path, tmp_path, tmp_path)}
    assert cases == {
        "segloc info good": ["silent"], "segloc info odd/right": ["refused"],
        "faulty": ["silent"], "noted": [], "broken": ["traceback"], "far": ["false"],
        "hangs": ["killed"],
    }  # fmt: skip
    assert "slow" in Case("noted", ["note"], [0], cpu_s=11.0).flags()


@pytest.mark.skipif(sys.platform != "linux", reason="times processes as Linux lists them")
def test_output_without_commands_has_a_case_per_line(tmp_path: Path) -> None:
    (tmp_path / "run.sh").write_text(
        "echo 'bytes   TRACEBACK TypeError'; echo '(N, 2)  found'; exit 3"
    )
    first, second, end = run_case(tmp_path, tmp_path, tmp_path)
    assert (first.flags(), second.flags(), end.statuses) == (["traceback"], ["silent"], [3])
