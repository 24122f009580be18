"""What the command line says first, and how: answers, help, notes on wrong keys."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from samples.walk import POINTS_ASIDE, Site, run, walked_site

from segloc import cli
from segloc.io import read_trajectory


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    return walked_site(tmp_path_factory.mktemp("site"))


@pytest.mark.slow
def test_one_scan_gives_one_line_with_its_pose(
    site: Site, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert run("localize", site.run / "0004.npy", "--map", site.map) == 0
    out, err = capsys.readouterr()
    found = re.fullmatch(
        r"localized at x (\S+), y (\S+), z (\S+) m, yaw (\S+) deg; confidence (0\.\d\d|1\.00) "
        r"\(\d+ segments agree, \d+% of the cloud lies on the map\)\n",
        out,
    )
    assert found and err == ""
    truth = read_trajectory(site.run / "poses.tum").at(4)
    assert truth is not None
    assert np.allclose([float(v) for v in found.groups()[:3]], truth[:3, 3], atol=0.3)


@pytest.mark.slow
def test_one_scan_that_is_not_found_says_why(
    site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "0.npy", POINTS_ASIDE)
    assert run("localize", tmp_path / "0.npy", "--map", site.map) == 0
    out, err = capsys.readouterr()
    assert re.fullmatch(r"not localized: [a-z].*; confidence 0\.\d\d\n", out)
    assert "were they taken within the map?" in err or "Likely cause" in err


@pytest.mark.slow
def test_a_prior_that_excludes_the_place_is_named(
    site: Site, capsys: pytest.CaptureFixture[str]
) -> None:
    prior = ("--near", "900,900", "--radius", "5")
    assert run("localize", site.run / "0004.npy", "--map", site.map, *prior) == 0
    out, err = capsys.readouterr()
    assert out.startswith("not localized: not near the prior")
    assert "Likely cause: the prior excludes them: query 4 is at" in " ".join(err.split())


@pytest.mark.slow
def test_many_answers_are_a_table_with_the_worst_first(
    site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for i in range(3):
        np.save(tmp_path / f"{i}.npy", np.load(site.run / f"000{i + 3}.npy"))
    np.save(tmp_path / "3.npy", POINTS_ASIDE)
    assert run("localize", tmp_path, "--map", site.map) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = [line for line in lines if re.search(r"│ +[0-3] │|│ [0-3] +│", line)]
    assert "x " not in rows[0] and rows[0].split("│")[1].strip() == "3"
    assert all("yaw" in row for row in rows[1:4])


@pytest.mark.slow
def test_json_on_stdout_is_all_of_it(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run("localize", site.run, "--map", site.map, "--select", "4:5", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["summary"]["queries"] == len(found["queries"]) == 2
    assert {"T_map_sensor", "confidence", "reason", "message"} <= found["queries"][0].keys()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("treads: 1", r"treads: no such key: did you mean threads\?"),
        ("segmentaton: {}", r"segmentaton: no such key: did you mean segmentation\?"),
        ("local_cloud: {radius: 3}", r"did you mean local_cloud\.radius_m\?"),
        ("min_confidence: 0.5", r"did you mean verification\.min_confidence\?"),
        ("purple: 1", r"no such key: `segloc config --all` prints all of them"),
    ],
)
def test_unknown_keys_say_what_may_be_meant(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    file = tmp_path / "c.yaml"
    file.write_text(text)
    assert run("doctor", tmp_path, "--config", file) == 1
    assert re.search(said, capsys.readouterr().err)


def verbs(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    inner = getattr(command, "commands", None)
    if inner is None:
        yield name, command
    for key, each in (inner or {}).items():
        yield from verbs(each, f"{name} {key}")


OURS = [
    each
    for each in verbs(typer.main.get_command(cli.app), "segloc")
    if each[1].callback.__module__.startswith("segloc.")
]


@pytest.mark.parametrize(("name", "command"), OURS, ids=[name for name, _ in OURS])
def test_every_option_says_what_it_is_and_in_which_unit(name: str, command: Any) -> None:
    assert command.help, name
    for option in command.params:
        if option.name == "help":
            continue
        assert option.help, option.opts
        if not getattr(option, "is_flag", False):
            assert option.metavar and re.match(r"\[?[A-Z]", option.metavar), option.opts


def test_verbs_come_in_the_order_of_use() -> None:
    root: Any = typer.main.get_command(cli.app)
    names = [name for name in root.list_commands(None) if name in cli.ORDER]
    assert names == [name for name in cli.ORDER if name in names]
    assert set(cli.ORDER) <= set(root.commands)


def test_lines_are_whole_where_stdout_is_no_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from segloc.cli.console import note, table

    path = tmp_path / ("long" * 60)
    table(str(path), ("", ""), [("path", str(path))])
    note(str(path))
    out, err = capsys.readouterr()
    assert out.count(str(path)) == 2 and str(path) in err


def test_progress_is_a_line_now_and_then_where_stderr_is_no_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from segloc.cli import console

    now = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with console.progress("Training") as update:
        for done in range(7):
            update(done, 6)
            now[0] += 0.6 * console.SECONDS_A_LINE
    assert capsys.readouterr().err == "Training: 2 of 6\nTraining: 4 of 6\n"
