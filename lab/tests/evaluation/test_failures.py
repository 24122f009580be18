"""The funnel: every stage at which a query can be lost, each brought about on purpose."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from segloc_lab.evaluation.failures import funnel
from segloc_lab.evaluation.scenario import QuerySet
from segloc_lab.padding import remade
from typer.testing import CliRunner

from segloc import Config, Localizer, SegmentMap, build_map
from segloc.tools.cli import app
from segloc.tools.io import Trajectory, write_tum


@pytest.fixture(scope="module")
def walk(plaza: Plaza) -> PlazaSequence:
    return PlazaSequence(plaza, steps=6)


@pytest.fixture(scope="module")
def prior_map(walk: PlazaSequence) -> SegmentMap:
    return build_map(walk, Config.preset("geo"))


def queries(walk: PlazaSequence, positions: Iterable[int]) -> QuerySet:
    chosen = np.array(list(positions), dtype=np.int64)
    return QuerySet(walk, chosen, walk.poses[chosen])


def by_segments(**sections: Any) -> Config:
    """Without the occupancy search, which would find what segments do not."""
    config = Config.preset("geo")
    occupancy = config.occupancy.model_copy(update={"enabled": False})
    return config.model_copy(update={"occupancy": occupancy, **sections})


def stages(localizer: Localizer, walk: PlazaSequence) -> set[str]:
    return {case.stage for case in funnel(localizer, queries(walk, [2, 5])).cases}


def test_a_rejected_pose_names_its_gate(prior_map: SegmentMap, walk: PlazaSequence) -> None:
    config = Config.preset("geo")
    gates = config.verification.model_copy(update={"min_confidence": 1.0})
    localizer = Localizer(prior_map, config.model_copy(update={"verification": gates}))
    found = funnel(localizer, queries(walk, [2, 5]))
    assert found.counts()["pose found but rejected"] == 2
    assert found.details() == {"too uncertain": 2} and len(found.worst(1)) == 1


def test_matches_and_segments_that_are_missing(prior_map: SegmentMap, walk: PlazaSequence) -> None:
    shuffled = remade(prior_map, vectors=np.roll(prior_map.vectors, 7, axis=0))
    matching = Config.preset("geo").matching
    one = matching.model_copy(update={"neighbours": 1, "escalation": 1})
    few = by_segments(matching=one, threads=1)
    assert stages(Localizer(shuffled, few), walk) == {"true neighbours not matched"}
    moved = remade(prior_map, centroids=prior_map.centroids + np.array([0, 0, 30.0]))
    assert stages(Localizer(moved, few), walk) == {"segments not repeated"}


def test_the_verb_writes_the_funnel_and_pictures(
    prior_map: SegmentMap, walk: PlazaSequence, tmp_path: Path
) -> None:
    pytest.importorskip("matplotlib")
    run, out = tmp_path / "run", tmp_path / "out"
    run.mkdir()
    for i in range(3):
        np.save(run / f"{i:06d}.npy", walk.scan(i).points)
    write_tum(tmp_path / "truth.tum", Trajectory(np.arange(3.0), walk.poses[:3]))
    prior_map.save(tmp_path / "site.segmap")
    (tmp_path / "c.yaml").write_text("verification: {min_confidence: 1.0}\n")
    arguments = [run, "--map", tmp_path / "site.segmap", "--truth", tmp_path / "truth.tum"]
    arguments += ["--out", out, "--pictures", 1, "--config", tmp_path / "c.yaml"]
    result = CliRunner().invoke(app, ["evaluate", "failures", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    assert json.loads((out / "funnel.json").read_text())["within_coverage"] == 3
    assert [p.suffix for p in sorted(out.iterdir())] == [".png", ".json"]
    assert "pose found but rejected" in result.output
