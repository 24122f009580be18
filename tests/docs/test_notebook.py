"""The notebook runs from its first cell to its last, with the results in its text."""

from __future__ import annotations

import pytest
from samples.source import PROJECT

NOTEBOOK = PROJECT / "examples" / "first_steps.ipynb"
SECONDS = 900


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of what runs notebooks
def test_the_notebook_runs() -> None:
    pytest.importorskip("matplotlib", reason="pictures need the extra 'report'")
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(notebook, timeout=SECONDS, kernel_name="python3").execute()
    cells = [cell.outputs for cell in notebook.cells if cell.cell_type == "code"]
    # A kernel may send what one call prints in several pieces.
    printed = ["".join(output.get("text", "") for output in outputs) for outputs in cells]
    shown = "".join(printed)
    assert "confidence" in shown and "cm off" in shown and "first sight" in shown
    assert "False - " in printed[-1]
    pictures = [
        output for outputs in cells for output in outputs if "image/png" in output.get("data", {})
    ]
    assert len(pictures) == 3
