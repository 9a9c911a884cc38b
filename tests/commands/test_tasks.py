import json

from minitouch_bench.protocol.minitouch import PROTOCOL, TASK_NAMES
from tests.commands.command import run


def test_the_tasks_are_listed(tmp_path):
    done = run("tasks", directory=tmp_path)
    assert (done.code, done.err) == (0, "")
    for task in TASK_NAMES:
        (line,) = [line for line in done.out.splitlines() if PROTOCOL.task(task).gym_id in line]
        assert task in line
        assert f"({5 if task == 'opening' else 4},)" in line


def test_tasks_and_suites_can_be_read_by_a_program(tmp_path):
    document = json.loads(run("tasks", "--json", directory=tmp_path).out)
    assert [task["name"] for task in document["tasks"]] == list(TASK_NAMES)
    smoke = next(suite for suite in document["suites"] if suite["name"] == "smoke")
    assert smoke["episodes_per_task"] == 5
    assert set(smoke["tasks"]) <= set(TASK_NAMES)
