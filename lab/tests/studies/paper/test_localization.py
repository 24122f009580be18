"""The localization study on a tiny test set: right counts, and a run that is cut off goes on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from samples.tiny_suite import TINY
from segloc_lab.evaluation import comparison, comparison_study
from segloc_lab.evaluation.comparison import ready, shared_config
from segloc_lab.evaluation.comparison_study import answered
from segloc_lab.evaluation.study import Study, Table
from segloc_lab.simulation.suites import SUITES
from segloc_lab.studies.paper import localization
from segloc_lab.studies.paper.localization import KittiScenario, SuiteScenario, scenarios
from segloc_lab.studies.paper.workspace import Workspace

from segloc import Localizer, build_map
from segloc.errors import DatasetError
from segloc.map.compact import CompactConfig
from segloc.map.config import MappingConfig
from segloc.tools.batch.run import localize_sequence

METHOD = "geo"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("evaluation")


@pytest.fixture
def workspace(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Workspace:
    pytest.importorskip("embreex", reason="the simulation needs embreex")
    monkeypatch.setitem(SUITES, "tiny", (TINY,))
    return Workspace(folder, suite="tiny", scale="full", methods=(METHOD, "profile"))


@pytest.fixture
def study(workspace: Workspace) -> Study:
    """From the cache for every test but the first."""
    return localization.run(workspace)


def table(study: Study, name: str) -> Table:
    return next(each for each in study.tables if each.name == name)


@pytest.mark.slow
def test_counts_are_those_of_the_package_itself(study: Study, workspace: Workspace) -> None:
    """Segments shared by all methods give what a map and a localizer of one method give."""
    opened = SuiteScenario(TINY, "full", 0).open()
    query_set = opened.query_sets["test_0"]
    every_view = MappingConfig(compact=CompactConfig(enabled=False))  # as studies compare methods
    config = shared_config(METHOD, 1, segments_alone=True)
    config = config.model_copy(update={"mapping": every_view})
    localizer = Localizer(build_map(opened.map, config), config)
    expected = localize_sequence(localizer, query_set.recording, query_set.positions)
    (found,) = answered(workspace, scenarios(workspace), ready((METHOD,)))
    answers = found.answers[METHOD]["test_0"]["map"]["consensus"]
    assert [a["reason"] for a in answers] == [r.reason for r in expected]
    assert [a["inliers"] for a in answers] == [r.inliers for r in expected]
    for answer, result in zip(answers, expected, strict=True):
        if result.T_map_sensor is not None:
            np.testing.assert_array_equal(answer["T_map_sensor"], result.T_map_sensor.ravel())


@pytest.mark.slow
def test_the_tables_count_what_was_answered(study: Study) -> None:
    ((*_, queries, places, found, others),) = table(study, "localizations-consensus").rows
    assert queries == 8 and isinstance(places, int) and 3 <= places <= 8
    assert all(isinstance(cell, int) and cell >= 4 for cell in (found, others))
    for negatives in ("negatives-consensus", "negatives-published"):
        assert table(study, negatives).rows[-1][1:] == (8, 0, 0)


@pytest.mark.slow
def test_a_run_that_is_cut_off_goes_on_with_the_next_piece(
    study: Study, workspace: Workspace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(comparison_study, "PIECE", 3)
    whole, begun = comparison.localize_all, []

    def cut_off(*arguments: object) -> object:
        begun.append(arguments)
        if len(begun) == 2:
            raise KeyboardInterrupt
        return whole(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(comparison, "localize_all", cut_off)
    fresh = replace(workspace, out=tmp_path, methods=(METHOD,))
    with pytest.raises(KeyboardInterrupt):
        answered(fresh, scenarios(fresh), ready((METHOD,)))
    (found,) = answered(fresh, scenarios(fresh), ready((METHOD,)))
    assert not list(tmp_path.glob("cache/maps-*"))
    (expected,) = answered(workspace, scenarios(workspace), ready((METHOD,)))
    assert found.answers == expected.answers
    for name, array in expected.arrays.items():
        np.testing.assert_array_equal(found.arrays[name], array)


def test_kitti_without_its_folders_is_one_line(tmp_path: Path) -> None:
    scenario = KittiScenario(tmp_path, False, "small", 0)
    with pytest.raises(DatasetError, match="keyframes: no such folder; --kitti needs"):
        scenario.settings()
