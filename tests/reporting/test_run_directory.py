import json
import subprocess
import sys
from dataclasses import replace

import pytest

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.reporting.report import write_views
from minitouch_bench.runs.run import read_run, run_json
from tests.reporting.synthetic import make_run, write


def test_a_run_reads_back_as_it_was_written(tmp_path):
    run = write(make_run(episodes=4, faults=1), tmp_path / "a")
    assert run.name == "a"
    assert run.directory == tmp_path / "a"
    assert run.content == (tmp_path / "a" / "run.json").read_bytes() == run_json(run)
    assert read_run(tmp_path / "a" / "run.json") == run


def test_a_run_has_two_views(tmp_path):
    run = write(make_run(episodes=4, faults=1), tmp_path / "a")
    write_views(run, tmp_path / "a")
    names = sorted(file.name for file in (tmp_path / "a").iterdir())
    assert names == ["episodes.csv", "report.html", "run.json"]


def test_equal_runs_give_equal_bytes_apart_from_the_times(tmp_path):
    run = make_run(episodes=5, faults=1)
    environment = replace(run.environment, started="2031-12-31T23:59:59Z", wall_s=1.0)
    again, later = make_run(episodes=5, faults=1), replace(run, environment=environment)
    for place, made in (("one", run), ("two", again), ("three", later)):
        write_views(write(made, tmp_path / place / "run"), tmp_path / place / "run")
    for file in (tmp_path / "one" / "run").iterdir():
        first = file.read_bytes()
        assert first == (tmp_path / "two" / "run" / file.name).read_bytes(), file.name
        later = (tmp_path / "three" / "run" / file.name).read_text("utf-8")
        if file.name == "report.html":
            later = later.replace("2031-12-31T23:59:59Z", run.environment.started)
            later = later.replace("took 1 s", "took 754 s")
        if file.name != "run.json":
            assert first.decode() == later, file.name


def test_a_directory_without_a_run_is_refused(tmp_path):
    with pytest.raises(RunDirectoryError, match=r"it has no run\.json"):
        read_run(tmp_path)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe\x00", b'{"format": "run\xe1"}'])
def test_a_file_that_is_no_json_is_refused(tmp_path, content):
    (tmp_path / "run.json").write_bytes(content)
    with pytest.raises(RunDirectoryError, match="is not JSON"):
        read_run(tmp_path)


def test_a_malformed_run_names_its_directory(tmp_path):
    (tmp_path / "run.json").write_text(json.dumps({"format": "x"}))
    with pytest.raises(RunDirectoryError, match=tmp_path.name):
        read_run(tmp_path)


def test_a_run_that_cannot_be_written_is_said_in_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunDirectoryError, match="cannot be written"):
        write(make_run(tasks=("playing",), episodes=1), tmp_path / "file" / "run")


def test_a_report_is_drawn_without_torch_or_pybullet():
    code = (
        "import sys; import minitouch_bench.reporting, minitouch_bench.metrics; "
        "print([m for m in ('torch', 'pybullet', 'pandas') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
