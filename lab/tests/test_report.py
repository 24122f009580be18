"""Reports are complete, name their command, and are never rewritten."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from segloc_lab.report import Table, publish, reporting, write

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
