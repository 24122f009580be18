"""The output of ``--help``: the verbs in the order of use, a default and a unit of every option."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import typer
from samples.walk import run

from segloc.config import Config
from segloc.errors import ConfigError
from segloc.tools.cli import ORDER, app
from segloc.tools.cli.verbs import first_sentence

ROOT: Any = typer.main.get_command(app)
OWN = set(ORDER)
"""Verbs of this distribution; others add theirs."""


def verbs(command: Any = ROOT, name: str = "segloc") -> Iterator[tuple[str, Any]]:
    for inner in getattr(command, "commands", {}):
        yield from verbs(command.commands[inner], f"{name} {inner}")
    if not hasattr(command, "commands"):
        yield name, command


EVERY = [each for each in verbs() if each[0].split()[1] in OWN]


@pytest.mark.parametrize(("name", "command"), EVERY, ids=[name for name, _ in EVERY])
def test_every_argument_says_what_it_is_and_its_default(name: str, command: Any) -> None:
    own = command.callback.__module__.startswith("segloc.")
    assert (command.help or "").strip(), f"{name} has no help"
    for option in command.params if own else ():
        if option.name == "help":
            continue
        assert (option.help or "").strip(), f"{name}: {option.name} has no help"
        assert option.metavar or option.is_flag, f"{name}: {option.name} names no unit or kind"
        told = option.required or isinstance(option.show_default, str)
        assert told or option.default not in (None, "", [], ()), f"{name}: {option.name}: default?"
        if isinstance(option.default, float) and math.isfinite(option.default):
            unit = f"{option.metavar} {option.help}"
            assert re.search(r"METRES|DEGREES|FACTOR|SHARE|MINUTES|0 to 1", unit), (name, unit)


RECORDINGS = ("SEQUENCE", "SCAN")


@pytest.mark.parametrize(("name", "command"), EVERY, ids=[name for name, _ in EVERY])
def test_every_verb_on_a_recording_takes_a_part_of_it(name: str, command: Any) -> None:
    arguments = [each for each in command.params if each.param_type_name == "argument"]
    if command.callback.__module__.startswith("segloc."):
        assert all(re.fullmatch(r"[A-Z_]+(\.segmap)?", each.metavar) for each in arguments), name
    options = {option for each in command.params for option in each.opts}
    if any(each.metavar in RECORDINGS for each in arguments):
        assert "--select" in options, name


def test_defaults_are_shown(capsys: pytest.CaptureFixture[str]) -> None:
    """Also those that are no value: brackets in a help text would be taken for markup."""
    assert run("localize", "--help") == 0
    output = " ".join(capsys.readouterr().out.split())
    assert "[default: (its own)]" in output and "[default: (all)]" in output


def loaded(*words: str) -> set[str]:
    """The modules that a command loads, which prints something and ends."""
    code = (
        "import atexit, sys; from segloc.tools.cli import main; "
        "atexit.register(lambda: print(*sys.modules, file=sys.stderr)); "
        f"sys.argv[1:] = {list(words)}; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert done.stdout
    return set(done.stderr.split())


@pytest.mark.slow
def test_help_loads_little() -> None:
    assert not loaded("--help") & {"numpy", "scipy", "pydantic", "rich"}
    one = loaded("localize", "--help")
    assert "segloc.tools.cli.localize" in one
    assert not one & {"numpy", "scipy", "segloc_lab.cli.simulate"}
    assert not {name for name in loaded("--version") if name.startswith("segloc.tools.cli.map")}


def test_the_shell_completes_verbs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("_SEGLOC_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "segloc lo")
    monkeypatch.setenv("COMP_CWORD", "1")
    with pytest.raises(SystemExit):
        app(prog_name="segloc")
    assert capsys.readouterr().out.split() == ["localize"]


@pytest.mark.parametrize(
    ("words", "meant"), [(("lokalize",), "localize"), (("map", "biuld"), "build")]
)
def test_a_verb_that_is_misspelt_is_guessed(
    words: tuple[str, ...], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*words) == 2
    assert f"Did you mean '{meant}'?" in " ".join(capsys.readouterr().err.split())


def test_a_key_that_is_misspelt_is_guessed(tmp_path: Any) -> None:
    for text, meant in (
        ("local_cloud: {radius: 30}", "local_cloud.radius_m"),
        ("verification: {min_confidense: 0.9}", "verification.min_confidence"),
        ("min_confidence: 0.9", "verification.min_confidence"),
    ):
        file = tmp_path / "c.yaml"
        file.write_text(text)
        with pytest.raises(ConfigError, match=f"did you mean {meant}"):
            Config.load(file)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Is it so? (Fig. 5)", "Is it so? (Fig. 5)"),
        ("Do this. Then that.\n\nAnd more.", "Do this."),
        ("Do this on\n    two lines.\n\nMore.", "Do this on two lines."),
    ],
)
def test_lists_of_verbs_show_whole_sentences(text: str, shown: str) -> None:
    assert first_sentence(text) == shown
