from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.episode import Role
from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.limits import PolicyLimits
from minitouch_bench.runs.run import read_run
from minitouch_bench.verification.replay_check import draw_episodes, prepare_rerun, run_again
from tests.evaluation.runs import Here, request
from tests.verification.conftest import WANTED


@pytest.fixture
def opened(whole):
    return read_run(whole)


def test_the_draw_is_the_generator_s_in_the_run_s_order(opened):
    drawn = [draw_episodes(opened, 3, np.random.default_rng(seed)) for seed in range(20)]
    for role in Role:  # exploration does not make the ranked episodes rarer
        assert all(sum(spec.role is role for spec in specs) == 3 for specs in drawn)
    assert drawn[0] == draw_episodes(opened, 3, np.random.default_rng(0))
    assert len(set(drawn)) > 5
    assert all(list(specs) == sorted(specs, key=opened.header.specs().index) for specs in drawn)
    assert draw_episodes(opened, 99, np.random.default_rng(0)) == opened.header.specs()


def test_the_same_checkpoint_gives_the_same_bits_and_another_one_is_found(opened):
    seen, specs = [], opened.header.specs()
    found = run_again(opened, WANTED, specs, Here(), seen.append)
    assert {record.spec for record in seen} == set(specs)
    assert (found.problems, found.reran) == ((), len(seen))
    other = request("zero", ("pushing", "opening"), 2, exploration="zero")
    (difference,) = run_again(opened, other, specs[:1], Here()).problems
    assert difference.place == "pushing/0"
    assert "success recorded, step_limit when run again" in difference.what
    explored = [spec for spec in specs if spec.key == "exploration/pushing/0"]
    (difference,) = run_again(opened, other, explored, Here()).problems
    assert difference.place == "exploration/pushing/0"
    row = opened.rows[0]
    claimed = replace(row, clipped_actions=row.clipped_actions + 1)
    stranger = replace(opened, rows=(claimed, *opened.rows[1:]))
    (difference,) = run_again(stranger, WANTED, specs[:1], Here()).problems
    assert difference.place == "pushing/0"
    assert "clipped" in difference.what


def without_exploration(run, **of_plan):
    plan = replace(run.plan, **of_plan)
    return replace(run, header=replace(run.header, plan=plan, exploration=None))


def test_only_the_evaluated_checkpoint_is_run_again_and_cannot_read_the_run(opened):
    run = without_exploration(opened)
    with pytest.raises(UsageError, match="zero is not the policy of this run: zero"):
        prepare_rerun(run, "zero")
    setup = prepare_rerun(run, "scripted")
    assert setup.isolation.private == str(opened.directory.resolve())


@pytest.mark.parametrize(
    ("asked", "given"),
    [
        ({"memory_mb": 2**24, "act_timeout_s": 86_400.0}, PolicyLimits()),
        ({"act_timeout_s": 1.0}, PolicyLimits(act_timeout_s=1.0)),
    ],
)
def test_a_stranger_s_run_gives_its_policy_no_more_than_the_official_limits(opened, asked, given):
    stranger = without_exploration(opened, limits=PolicyLimits(**asked))
    notes = []
    setup = prepare_rerun(stranger, "scripted", note=notes.append)
    assert setup.plan.limits == setup.isolation.limits == given
    assert len(notes) == (given == PolicyLimits())
