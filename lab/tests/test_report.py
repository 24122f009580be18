"""Reports are complete and never rewritten; runs that are cut off resume."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
from segloc_lab import report
from segloc_lab.report import Table, publish, reporting, write
from segloc_lab.runner import Runner

from segloc.errors import ConfigError


def test_a_report_has_its_command_tables_and_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["/usr/bin/segloc", "bench", "--kitti", "/data/kitti00"])
    table = Table(("method", "n", "share"), [("dsm", 41, 0.25), ("geo", None, "0 of 3")], "A note.")
    folder = tmp_path / "new" / "report"
    text = write(folder, "A study", [table]).read_text()
    assert "kitti00" in text and "/data" not in text
    assert "| geo | - | 0 of 3 |" in text and "A note." in text
    (kept,) = json.loads((folder / "rows.json").read_text())
    assert kept["rows"] == [["dsm", 41, 0.25], ["geo", None, "0 of 3"]]
    assert "numpy" in (folder / "environment.txt").read_text()
    with pytest.raises(ConfigError, match="never rewritten"):
        publish(folder, "A study", table)
    with pytest.raises(SystemExit):
        reporting("A script.").parse_args(["--report", str(folder)])
    assert "never rewritten" in capsys.readouterr().err


def square(n: int) -> dict[str, Any] | None:
    return {"n": n, "square": n * n} if n != 3 else None


def test_a_run_resumes_and_adds_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(*words: str, out: str = "a.jsonl") -> list[int]:
        """Squares of the results."""
        monkeypatch.setattr(sys, "argv", ["x", "--out", str(tmp_path / out), *words])
        runner = Runner("x", "x.jsonl", first_seed=1, worlds=2, parallel=True, choosing=["shown"])
        runner.options.add_argument("--kind", default="plain")
        runner.options.add_argument("--shown")
        runner.parse()
        found = runner.run(square, runner.seeds, ("n",), lambda n: [n])
        return [each["square"] for each in found]

    assert run("--seconds", "0") == [1]  # no second one is begun
    assert run() == [1, 4]
    kept = (tmp_path / "a.jsonl").read_text()
    assert run("--worlds", "4") == [1, 4, 16]  # 3 has no result
    assert (tmp_path / "a.jsonl").read_text().startswith(kept)
    assert run("--first-seed", "7", "--worlds", "1", out="b.jsonl") == [49]
    files = [str(tmp_path / name) for name in ("a.jsonl", "b.jsonl")]
    assert run("--add", *files, out="c.jsonl") == [1, 4, 16, 49]
    assert not (tmp_path / "c.jsonl").exists()
    lines = len((tmp_path / "a.jsonl").read_text().splitlines())
    assert run("--kind", "other") == [1, 4]  # made anew
    assert len((tmp_path / "a.jsonl").read_text().splitlines()) == lines + 2
    assert run("--kind", "other", "--shown", "all") == [1, 4]
    with (tmp_path / "a.jsonl").open("a") as stream:
        stream.write('{"n": 4, "squ')  # a run that was killed
    assert run("--worlds", "3") == [1, 4, 16]
    assert len((tmp_path / "a.jsonl").read_text().splitlines()) == lines + 2
    with pytest.raises(ConfigError, match="different code or options"):
        run("--add", *files, out="c.jsonl")


def test_code_is_known_by_every_edit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "_CLONE", tmp_path)
    files = [tmp_path / name for name in ("src/a.py", "cpp/b.cpp", "lab/src/c.py")]
    for file in files:
        file.parent.mkdir(parents=True)
        file.write_text("1\n")
    who = ("-c", "user.name=x", "-c", "user.email=x@y")
    for words in (("init", "-q"), ("add", "."), (*who, "commit", "-qm", "x")):
        report.git(*words)
    seen = {report.code()}
    for k, file in enumerate([*files, tmp_path / "lab/src/new.py"], 2):
        for edit in (f"{k}\n", f"{k}, too\n"):
            file.write_text(edit)
            assert report.code() not in seen and report.commit().endswith("+")
            seen.add(report.code())
    (tmp_path / "README.md").write_text("x")
    assert report.code() in seen
