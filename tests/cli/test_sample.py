"""``segloc sample``: from nothing to answers, as its own output says."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from samples.walk import run


@pytest.mark.slow
def test_the_commands_that_it_prints_work_as_they_stand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("embreex", reason="the simulator needs the extra 'sim'")
    from segloc.cli import sample

    monkeypatch.setattr(sample, "LENGTH_M", 80.0)
    out = tmp_path / "sample"
    assert run("sample", "--out", out, "--workers", 1) == 0
    commands = [line for line in capsys.readouterr().out.splitlines() if line.startswith("segloc ")]
    said = {}
    for command in commands[:4]:
        words = shlex.split(command)[1:]
        assert run(*words) == 0, command
        said[words[0]] = capsys.readouterr().out
    assert "nothing wrong is found" in said["doctor"]
    found = re.search(r"within map coverage │ +(\d+) of (\d+) │", said["localize"])
    assert found and int(found[1]) > 0.7 * int(found[2]) > 0
    assert re.search(r"false +│ +0 │", said["localize"])
    assert said["explain"].startswith("not localized, ")
    assert (out / "results" / "debug").is_dir() and commands[4].startswith("segloc view ")


@pytest.mark.slow
def test_the_same_seed_gives_the_same_sample(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("embreex", reason="the simulator needs the extra 'sim'")
    from segloc.cli import sample

    monkeypatch.setattr(sample, "LENGTH_M", 12.0)
    monkeypatch.setattr(sample, "SIZE_M", 140.0)
    for name in ("a", "b"):
        assert run("sample", "--out", tmp_path / name, "--seed", 4, "--workers", 1) == 0
    files = sorted((tmp_path / "a").rglob("*.*"))
    assert len(files) > 5
    for file in files:
        assert (tmp_path / "b" / file.relative_to(tmp_path / "a")).read_bytes() == file.read_bytes()
