"""The recipes of docs/how-to/extend.md work as they are written there."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from samples.source import PROJECT, loaded

from segloc import Config, Localizer, build_map, geometry
from segloc.descriptors import available, base, create
from segloc.system.plugins import plugins
from segloc.tools.datasets import formats, open_sequence
from segloc.tools.datasets.formats import Format
from segloc.tools.io import Trajectory, write_tum

PAGE = (PROJECT / "docs" / "how-to" / "extend.md").read_text("utf-8")
FENCED = re.compile(r"^```\w+\n# (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
BLOCKS = dict(FENCED.findall(PAGE))


def section(title: str) -> str:
    """The text below a heading, up to the next one."""
    found = re.search(rf"^## {title}\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
    assert found, f"extend.md has no section {title!r}"
    return found[1]


def listed(title: str) -> list[str]:
    """The files that a recipe's table names."""
    return re.findall(r"^\| `([^`]+)` \|", section(title), re.MULTILINE)


def written(path: str, folder: Path) -> ModuleType:
    """The module of one of the page's blocks."""
    file = folder / Path(path).name
    file.write_text(BLOCKS[path], encoding="utf-8")
    return loaded(file)


@pytest.mark.parametrize("what", ["descriptor", "loader", "sensor", "study", "kernel"])
def test_the_files_of_each_recipe_are_where_it_says(what: str) -> None:
    files = listed(f"Add a {what}")
    assert files
    for name in files:
        path = PROJECT / name
        # NAME stands for the new file: its folder must be there.
        assert (path.parent if "NAME" in name else path).exists(), name


@pytest.mark.slow
def test_a_descriptor_of_a_package_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, plaza: Plaza
) -> None:
    group, name, value = plugin_of(BLOCKS["pyproject.toml"])
    (tmp_path / "segloc_cubes.py").write_text(BLOCKS["segloc_cubes.py"], encoding="utf-8")
    made = tmp_path / "segloc_cubes-0.1.dist-info"  # what pip leaves of it
    made.mkdir()
    (made / "METADATA").write_text("Metadata-Version: 2.1\nName: segloc-cubes\nVersion: 0.1\n")
    (made / "entry_points.txt").write_text(f"[{group}]\n{name} = {value}\n")
    assert name not in available()  # and so the package's own are known
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(base, "_entries", dict(base._entries))
    forget_plugins()
    try:
        assert name in available()
        config = Config.preset(name)
        assert config.matching.neighbours == 50
        localizer = Localizer(build_map(PlazaSequence(plaza), config), config)
        assert localizer.descriptor.name == name and create(name).dim == 3
        result = localizer.localize(plaza.scan(geometry.yaw_transform(1.0, (2.0, 1.0, 1.8))))
        assert result.proposer == "first sight" and result.counts["matches"] == 0
        clouds = config.occupancy.model_copy(update={"enabled": False})
        by_segments = config.model_copy(update={"occupancy": clouds})
        localizer = Localizer(localizer.prior_map, by_segments)
        result = localizer.localize(plaza.scan(geometry.yaw_transform(1.0, (2.0, 1.0, 1.8))))
        assert result.counts["segments"] > 0 and result.counts["matches"] > 0
    finally:
        sys.modules.pop("segloc_cubes", None)
        forget_plugins()


def forget_plugins() -> None:
    """Let descriptors be discovered again."""
    plugins.cache_clear()
    base._discover.cache_clear()


def plugin_of(text: str) -> tuple[str, str, str]:
    """Group, name and value of the one entry point of a pyproject.toml."""
    found = re.search(r'\[project\.entry-points\."([^"]+)"\]\n(\w+) = "([\w:]+)"', text)
    assert found
    return found[1], found[2], found[3]


def test_a_loader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    yard = written("src/segloc/tools/datasets/loaders/yard.py", tmp_path)
    drive = tmp_path / "drive"
    (drive / "cloud").mkdir(parents=True)
    rng = np.random.default_rng(0)
    stamps = 1_600_000_000.0 + 0.1 * np.arange(4)
    clouds = [rng.uniform(1, 9, (50, 4)).astype("<f4") for _ in stamps]
    for stamp, cloud in zip(stamps, clouds, strict=True):
        (drive / "cloud" / f"{round(stamp * 1e9)}.bin").write_bytes(cloud.tobytes())
    poses = np.stack([geometry.yaw_transform(0.1 * k, (k, 0.0, 0.0)) for k in range(4)])
    write_tum(drive / "yard.tum", Trajectory(stamps, poses))
    known: tuple[Format, ...] = (yard, *formats.FORMATS)  # type: ignore[assignment]
    monkeypatch.setattr(formats, "FORMATS", known)
    for path in (drive, drive / "cloud"):
        recording = open_sequence(path)
        assert len(recording) == 4
        np.testing.assert_array_equal(recording.scan(2).points, clouds[2][:, :3])
        assert recording.poses is not None
        np.testing.assert_allclose(recording.poses, poses, atol=1e-5)


def test_a_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workspaces = pytest.importorskip("segloc_lab.studies.paper.workspace")
    counting = written("lab/src/segloc_lab/studies/paper/counting.py", tmp_path)
    monkeypatch.setitem(sys.modules, "segloc_lab.studies.paper.counting", counting)
    workspace = workspaces.Workspace(tmp_path / "out", methods=("geo", "profile"))
    study = workspaces.run("counting", workspace)
    assert study.tables[0].rows == (("geo", 7), ("profile", 32))
    assert (tmp_path / "out" / "counting" / "study.json").is_file()
