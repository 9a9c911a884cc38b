"""The quickstart notebook runs from start to end, with a small budget."""

import pytest

from tests.altered import ROOT

nbformat = pytest.importorskip("nbformat")
NOTEBOOK = ROOT / "examples" / "quickstart.ipynb"
BUDGET = "TRAINING_STEPS = 300\nEPISODES = 2\n"


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_notebook_runs_from_start_to_end(tmp_path):
    nbclient = pytest.importorskip("nbclient")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    [parameters] = [
        cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", ())
    ]
    parameters.source = BUDGET
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=900, resources=resources).execute()
    assert (tmp_path / "reports" / "trained" / "run.json").exists()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert not [output for output in shown if output.output_type == "error"]
    pages = [str(output.data) for output in shown if "data" in output]
    assert sum("<progress" in page for page in pages) >= 3  # two runs and a training
    assert sum("Touch share" in page for page in pages) >= 2  # a table of results, a comparison
    assert sum("<iframe" in page for page in pages) == 1  # the replayed episode


def test_the_notebook_is_stored_with_what_it_shows():
    """GitHub runs no cell, and has no place for a page of a megabyte."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    shown = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    kinds = [output.output_type for output in shown]
    assert "error" not in kinds
    assert kinds.count("stream") <= 1
    data = [output.data for output in shown if "data" in output]
    tables = list(map(str, data))
    assert sum("Touch share" in table for table in tables) == 2  # of a run, and a comparison
    assert not [table for table in tables if "<progress" in table or "<iframe" in table]
    assert sum("image/png" in one for one in data) == 1
    assert NOTEBOOK.stat().st_size < 200_000
