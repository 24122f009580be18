"""Every module that runs as a script starts, and every shell script calls what there is."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest
import segloc_lab

ROOT = Path(segloc_lab.__file__).parent
MODULES = sorted(
    ".".join((ROOT.name, *path.relative_to(ROOT).with_suffix("").parts))
    for path in ROOT.rglob("*.py")
    if '\nif __name__ == "__main__":' in path.read_text("utf-8")
)
SHELL = sorted(ROOT.rglob("*.sh"))
FOREIGN = {"map_closures", "kiss_matcher", "kiss_slam", "open3d"}
"""Packages of which one must live in an environment of its own."""


@pytest.mark.parametrize("name", MODULES)
def test_a_script_says_what_it_does(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in FOREIGN:
            raise
        pytest.skip(f"{error.name} is not installed")
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit) as ended:
        module.main()
    assert ended.value.code == 0
    told = capsys.readouterr().out
    assert f"python -m {name}" in told and (module.__doc__ or "").splitlines()[0] in told


@pytest.mark.parametrize("path", SHELL, ids=lambda path: path.name)
def test_a_shell_script_is_sound(path: Path) -> None:
    subprocess.run(["bash", "-n", str(path)], check=True)
    text = path.read_text("utf-8")
    for config in re.findall(r"\$here/(\S+\.yaml)", text):
        pattern = re.sub(r"\$\{?\w+\}?", "*", config)
        assert list(path.parent.glob(pattern)), config
