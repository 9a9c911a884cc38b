import shlex
from dataclasses import replace

from minitouch_bench.perturbation import PolicyLimits
from minitouch_bench.reporting.labels import reproduce_command, run_labels, run_names


def test_runs_of_one_policy_are_told_apart(hac):
    again = replace(hac, name="second")
    assert run_names([hac, again]) == ("hac-seed1 (hac-seed1)", "hac-seed1 (second)")
    assert run_names([hac]) == ("hac-seed1",)


def test_labels_of_the_exploration_policy_are_said_too(hac):
    remote = replace(hac.header.exploration, notes=("remote",))
    labels = run_labels(replace(hac, header=replace(hac.header, exploration=remote)))
    assert "exploration policy: remote" in labels


def test_an_official_run_is_repeated_by_its_suite_alone(hac):
    plan = replace(hac.plan, episodes=100)
    assert reproduce_command(replace(hac.header, plan=plan)) == (
        "minitouch-bench evaluate checkpoints/hac-seed1.safetensors --suite table4 "
        "--exploration e.safetensors"
    )


def test_an_unofficial_run_names_what_differs(scripted):
    header = replace(scripted.header, plan=replace(scripted.plan, seed=7))
    assert reproduce_command(header).endswith("--tasks playing,pushing --episodes 5 --seed 7")


def test_limits_and_isolation_are_those_of_the_run(hac, scripted):
    plan = replace(hac.plan, limits=PolicyLimits(act_timeout_s=2.5, episode_timeout_s=60.0))
    limited = replace(hac.header, plan=plan, isolation="process", official=False)
    command = reproduce_command(limited)
    assert "--episodes 20 --act-timeout 2.5 --episode-timeout 60 --exploration" in command
    assert command.endswith("--isolation process --trust")
    policy = replace(scripted.header.policy, kind="scripted")  # which runs there in any case
    beside = replace(scripted.header, policy=policy, isolation="none")
    assert "--isolation" not in reproduce_command(beside)
    explored = replace(hac.header.exploration, kind="factory")
    assert reproduce_command(replace(hac.header, exploration=explored)).endswith("--trust")


def test_a_source_cannot_add_a_command(hac):
    policy = replace(hac.header.policy, source="x.pt; rm -r y\nls", kind="factory")
    words = shlex.split(reproduce_command(replace(hac.header, policy=policy)))
    assert words[2] == "x.pt; rm -r y ls"
    assert words[-1] == "--trust"
