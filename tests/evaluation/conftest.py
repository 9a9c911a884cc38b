from pathlib import Path

import pytest

from minitouch_bench.runs.run import Run
from tests.evaluation.runs import request, run


@pytest.fixture(scope="session")
def finished(tmp_path_factory) -> tuple[Run, Path]:
    """Six episodes by one worker, and their directory, which nobody may change."""
    directory = tmp_path_factory.mktemp("finished")
    return run(request(), directory), directory
