"""The notebook: every cell runs, and prints what is stored in the page."""

from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[2] / "docs/notebook.ipynb"


def texts(notebook) -> list[str]:
    """What the cells print or show as text; pictures apart."""
    found = []
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            text = output.get("text") or output.get("data", {}).get("text/plain", "")
            found.append("(picture)" if "image/png" in output.get("data", {}) else text.strip())
    return found


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the tools that run the notebook
def test_every_cell_prints_what_the_page_shows(tmp_path):
    nbformat = pytest.importorskip("nbformat", reason="needs the extra docs")
    nbclient = pytest.importorskip("nbclient", reason="needs the extra docs")
    notebook = nbformat.read(NOTEBOOK, 4)
    stored = texts(notebook)
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute(cwd=str(tmp_path))
    assert texts(notebook) == stored
    assert "(picture)" in stored
