"""The table of docs/refusals.md is what the software says."""

from __future__ import annotations

import importlib.util
import re
from types import ModuleType

import pytest
from samples.source import PROJECT


def loaded() -> ModuleType:
    path = PROJECT / "docs" / "wrong_inputs.py"
    spec = importlib.util.spec_from_file_location("wrong_inputs", path)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_each_wrong_input_is_answered_as_the_table_says() -> None:
    wrong_inputs = loaded()
    table, kept = wrong_inputs.table(), wrong_inputs.kept(wrong_inputs.PAGE.read_text("utf-8"))

    def told(text: str) -> list[str]:
        """Figures aside, which may differ in their last digit on another processor."""
        rows = [line for line in text.splitlines() if line.startswith("| ") and "---" not in line]
        return [re.sub(r"-?\d+(\.\d+)?", "#", row) for row in rows]

    assert told(kept) == told(table)
    rows = [[cell.strip() for cell in row.strip("|").split(" | ")] for row in told(table)[1:]]
    assert len(rows) == len(wrong_inputs.WRONG) + 2
    refused = [row for row in rows if "`segloc map build` (#)" in row[-1]]
    assert len(refused) == sum(wrong.posed for wrong in wrong_inputs.WRONG)


def test_healthy_ends_with_0_and_each_fault_with_1_and_a_line() -> None:
    """As the table has it: one line each; a tilt alone is a note."""
    wrong_inputs = loaded()
    rows = wrong_inputs.kept(wrong_inputs.PAGE.read_text("utf-8")).splitlines()[3:-1]
    for row in rows:
        what, _, status, sentence, *_ = (cell.strip() for cell in row.strip("| ").split(" | "))
        assert sentence.startswith(("problem: ", "note: ", "segloc: error: "))
        assert (status == "0") == sentence.startswith("note: "), what
