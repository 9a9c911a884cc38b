"""Run the quickstart notebook, and store what it shows: GitHub shows that, and runs nothing."""

from copy import deepcopy
from pathlib import Path
from tempfile import TemporaryDirectory

import nbclient
import nbformat

NOTEBOOK = Path("examples/quickstart.ipynb")
TIMEOUT_S = 3600
"""Of a cell, on a busy machine; the training takes the longest."""

LONGEST = 50_000
"""Characters of HTML that are stored: an episode's page is longer, and GitHub shows none."""


def main() -> None:
    """Run every cell in an empty directory, and write the notebook with its outputs."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    metadata = deepcopy(notebook.metadata)
    with TemporaryDirectory() as folder:
        where = {"metadata": {"path": folder}}
        nbclient.NotebookClient(
            notebook, timeout=TIMEOUT_S, resources=where, record_timing=False
        ).execute()
    notebook.metadata = metadata
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if is_result(output)]
    nbformat.write(notebook, NOTEBOOK)


def is_result(output: nbformat.NotebookNode) -> bool:
    """Tell whether a reader wants an output: not progress; a page is left out of what is."""
    html = output.get("data", {}).get("text/html", "")
    if len(html) > LONGEST:
        del output.data["text/html"]
    return output.get("name") != "stderr" and "<progress" not in html


if __name__ == "__main__":
    main()
