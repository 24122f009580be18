"""The table of docs/reference/messages.md has the messages of the software."""

from __future__ import annotations

import re

import pytest
from samples.source import PROJECT, loaded


@pytest.mark.slow
def test_each_wrong_input_is_answered_as_the_table_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some of them: tests/tools/doctor has all, without the verbs."""
    wrong_inputs = loaded(PROJECT / "docs" / "wrong_inputs.py")
    monkeypatch.setattr(wrong_inputs, "WRONG", wrong_inputs.WRONG[1::5])
    table, kept = wrong_inputs.table(), wrong_inputs.kept(wrong_inputs.PAGE.read_text("utf-8"))

    def told(text: str) -> list[str]:
        """Rows without figures, which may differ in their last digit on another processor."""
        rows = [line for line in text.splitlines() if line.startswith("| ") and "---" not in line]
        return [re.sub(r"-?\d+(\.\d+)?", "#", row) for row in rows]

    head, *rows = told(table)
    assert len(rows) == len(wrong_inputs.WRONG) + 3 and head == told(kept)[0]
    assert [row for row in rows if row not in told(kept)] == []
