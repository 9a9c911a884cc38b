import json

from minitouch_bench.protocol.minitouch import PROTOCOL, TASK_NAMES
from tests.commands.command import run


def test_the_tasks_are_listed_for_people_and_for_programs(tmp_path):
    done = run("tasks", directory=tmp_path)
    assert (done.code, done.err) == (0, "")
    for task in TASK_NAMES:
        (line,) = [line for line in done.out.splitlines() if PROTOCOL.task(task).gym_id in line]
        assert task in line
        assert f"({5 if task == 'opening' else 4},)" in line
    document = json.loads(run("tasks", "--json", directory=tmp_path).out)
    assert [task["name"] for task in document["tasks"]] == list(TASK_NAMES)
    smoke = next(suite for suite in document["suites"] if suite["name"] == "smoke")
    assert smoke["episodes_per_task"] == 5
    assert set(smoke["tasks"]) <= set(TASK_NAMES)


def test_the_doctor_finds_this_machine_sound(tmp_path):
    done = run("doctor", "--json", "--workers", 2, directory=tmp_path)
    assert done.code == 0, done.out + done.err
    result = json.loads(done.out)
    verdicts = {check["name"]: check["verdict"] for check in result["checks"]}
    assert result["healthy"] is True
    assert {verdicts[name] for name in ("isolation", "policy repeats", "order and workers")} == {
        "ok"
    }


def test_the_doctor_names_what_is_wrong(tmp_path, monkeypatch):
    (tmp_path / "cache").write_text("no directory")
    monkeypatch.setenv("MINITOUCH_CACHE", str(tmp_path / "cache"))
    done = run("doctor", directory=tmp_path)
    assert done.code == 1
    assert "cannot be written" in " ".join(done.out.split())
    assert "Not to be trusted yet: cache" in done.out
