"""The notebooks of the documentation run, and print what stands in them.

UPDATE_NOTEBOOKS=1 writes what they print now.
"""

from __future__ import annotations

import os
from pathlib import Path

import nbclient
import nbformat
import pytest

FOLDER = Path(__file__).parents[3] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def printed(notebook: nbformat.NotebookNode) -> list[str]:
    """What each cell prints, in however many parts, or shows where there is nothing but text."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return ["".join(out.get("text") or out.data["text/plain"] for out in cell.outputs) for cell in cells]


def test_there_are_notebooks() -> None:
    assert {path.stem for path in NOTEBOOKS} >= {"first_recording", "thousand_runs", "two_devices"}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_prints_what_stands_in_it(path: Path, tmp_path: Path) -> None:
    written = nbformat.read(path, as_version=4)
    ran = nbformat.read(path, as_version=4)
    client = nbclient.NotebookClient(ran, timeout=120, kernel_name="python3", resources={"metadata": {"path": tmp_path}})
    client.execute()
    if os.environ.get("UPDATE_NOTEBOOKS"):
        for cell in ran.cells:
            cell.metadata.pop("execution", None)
        nbformat.write(ran, path)
    else:
        assert printed(ran) == printed(written)
