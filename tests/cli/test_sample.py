"""``segloc sample``: from nothing to answers, as its own output says."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from samples.walk import run


@pytest.mark.slow
def test_the_commands_that_it_prints_work_as_they_stand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "sample"
    assert run("sample", "--out", out) == 0
    commands = [line for line in capsys.readouterr().out.splitlines() if line.startswith("segloc ")]
    said = {}
    for command in commands[:4]:
        words = shlex.split(command)[1:]
        assert run(*words) == 0, command
        said[words[0]] = capsys.readouterr().out
    assert "no problems found" in said["doctor"]
    found = re.search(r"within map coverage │ +(\d+) of (\d+) │", said["localize"])
    assert found and int(found[1]) > 0.9 * int(found[2]) > 15
    assert re.search(r"false +│ +0 │", said["localize"])
    assert said["explain"].startswith("not localized, ")
    assert (out / "results" / "debug").is_dir() and commands[4].startswith("segloc view ")


def test_a_file_in_the_way_is_refused_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sample").write_text("mine")
    assert run("sample", "--out", tmp_path / "sample") == 1
    assert capsys.readouterr().err.startswith("segloc: error: ")
    assert (tmp_path / "sample").read_text() == "mine"
