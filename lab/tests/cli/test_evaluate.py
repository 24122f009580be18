"""``segloc evaluate`` with the studies of the paper, as the entry point adds them."""

from __future__ import annotations

from pathlib import Path

import pytest
from segloc_lab.evaluation.study import Study
from segloc_lab.studies.paper import workspace as studies

from segloc.cli import app
from segloc.errors import ConfigError, DatasetError, MissingDependency

pytestmark = pytest.mark.usefixtures("verbs")


def evaluate(*arguments: object) -> None:
    app(["evaluate", *map(str, arguments)], standalone_mode=False)


@pytest.mark.parametrize(
    ("arguments", "error", "line"),
    [
        (
            ("roc", "--suite", "seven"),
            ConfigError,
            "suite must be one of six, repeated, not 'seven'",
        ),
        (
            ("roc", "--scale", "huge"),
            ConfigError,
            "scale must be one of small, full, paper, not 'huge'",
        ),
        (("localization", "here"), ConfigError, "two recordings"),
        (("peers", "--sets", "lake"), ConfigError, "--sets: no 'lake'; available: single"),
        (("peers", "--python", "open3d"), ConfigError, "pass NAME=PYTHON"),
        (("peers", "--sets", "single"), DatasetError, "no folder kitti00 .*pass --data"),
        (("localization", "a", "b"), DatasetError, "a: no such file or folder"),
        (("localization", "--methods", "x"), ConfigError, "no method 'x'.* dsm"),
        (("localization", "--kitti", "x"), DatasetError, "x: no such folder; --kitti needs"),
        (("localization", "a", "b", "--every", "0"), ConfigError, "--every must be a positive"),
    ],
)
def test_what_the_user_can_mend_is_one_line(
    arguments: tuple[str, ...], error: type[Exception], line: str, tmp_path: Path
) -> None:
    with pytest.raises(error, match=line):
        evaluate(*arguments, "--out", tmp_path / "out")


def test_all_runs_every_study_and_leaves_out_what_cannot_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done: list[str] = []

    def run(name: str, workspace: object) -> Study:
        if name == "memory":
            raise MissingDependency("torch", "lab", "measuring memory")
        done.append(name)
        return Study(name, name.title())

    monkeypatch.setattr(studies, "run", run)
    evaluate("all", "--out", tmp_path)
    told = capsys.readouterr()
    assert "measuring memory needs torch" in " ".join(told.err.split())
    assert done == [name for name in studies.STUDIES if name != "memory"]
