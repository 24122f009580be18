"""The examples run, and do what they say."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

pytest.importorskip("embreex")
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SAYS = {
    "localize": r"(scan \d+: x .*\n){6}",
    "loops": r"drive.g2o: \d+ poses, \d+ loops, the last [01]\.\d\d m off\n\Z",
    "own_descriptor": r"found [5-8] of 8\n",
    "track": r"sure, by \d+ views\n\Z",
}


def test_every_example_is_tried() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(SAYS)


@pytest.mark.parametrize("name", SAYS)
def test_example(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    assert re.search(SAYS[name], capsys.readouterr().out)
