"""Queries localized part by part elsewhere are answered as they are here."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence

from segloc import Config, Localization, Localizer, Prior, SeglocError, build_map
from segloc.system.processes import single_threaded_pool
from segloc.tools.batch import run
from segloc.tools.batch.run import localize_parts, localize_sequence

GEO = Config.preset("geo").model_copy(update={"threads": 1})
COUNT = 8


@pytest.fixture(scope="module")
def place(plaza: Plaza, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("parts") / "plaza.segmap"
    build_map(PlazaSequence(plaza, steps=6), GEO).save(path)
    return path


@pytest.fixture(scope="module")
def drive(plaza: Plaza) -> PlazaSequence:
    return PlazaSequence(plaza, steps=COUNT)


@pytest.fixture(scope="module")
def expected(place: Path, drive: PlazaSequence) -> list[Localization]:
    from segloc import SegmentMap

    return localize_sequence(Localizer(SegmentMap.load(place), GEO), drive, np.arange(COUNT))


def same(found: list[Localization], expected: list[Localization]) -> bool:
    pairs = zip(found, expected, strict=True)
    return all(
        np.array_equal(a.T_map_sensor, b.T_map_sensor)
        if a.localized and b.localized
        else (a.localized, a.message, a.confidence) == (b.localized, b.message, b.confidence)
        for a, b in pairs
    )


@pytest.mark.slow
def test_any_executor_gives_the_same(
    place: Path, drive: PlazaSequence, expected: list[Localization], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "QUERIES", 3)
    output: list[tuple[int, int]] = []
    assert any(each.localized for each in expected)
    with ThreadPoolExecutor(2) as threads, single_threaded_pool(2) as processes:
        for executor in (threads, processes):
            found = localize_parts(
                str(place), GEO, drive, np.arange(COUNT), executor, lambda *at: output.append(at)
            )
            assert same(found, expected)
    assert output[-1] == (COUNT, COUNT)


def test_parts_know_the_prior_and_their_faults(place: Path, drive: PlazaSequence) -> None:
    far = Prior((500.0, 500.0), 20.0)
    with ThreadPoolExecutor(1) as executor:
        found = localize_parts(str(place), GEO, drive, np.arange(3), executor, near=far)
        assert not any(each.localized for each in found)
        assert localize_parts(str(place), GEO, drive, np.arange(0), executor) == []
        with pytest.raises((SeglocError, OSError)):
            localize_parts(str(place) + ".lost", GEO, drive, np.arange(3), executor)
