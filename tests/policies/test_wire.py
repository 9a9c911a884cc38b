from types import SimpleNamespace

import numpy as np
import pytest

from minitouch_bench.policies import wire
from minitouch_bench.policies.wire import pack_observation, unpack_observation
from minitouch_bench.text import describe, plain_line


def test_observation_survives(observation):
    payload = pack_observation(observation)
    assert len(payload) == 7056 + 44
    back = unpack_observation(payload)
    assert np.array_equal(back["image"], observation["image"])
    assert np.array_equal(back["touch"], observation["touch"])
    back["image"][0, 0, 0] = 1  # a policy may write into its copy


def test_text_of_a_policy_becomes_one_plain_line():
    text = "a\x1b[31mred\x1b[0m\r\nb\x07\u202ec\t\x1b]0;title\x07d"
    assert plain_line(text) == "ared bc d"
    assert len(plain_line("x" * 100_000)) == 200


class LyingError(Exception):
    @property
    def __traceback__(self):
        raise RuntimeError


class Name(str):
    __slots__ = ()

    def __format__(self, _):
        raise RuntimeError


def test_an_exception_that_lies_is_still_named_with_its_line():
    def fail():
        raise LyingError("x" * 1000)

    fail.__code__ = fail.__code__.replace(co_filename=Name("/home/me/\x1b[31m" + "y" * 1000))
    with pytest.raises(LyingError) as caught:
        fail()
    text = describe(caught.value)
    assert text.startswith("LyingError: xxx")
    assert text.endswith(f"… ({'y' * 99}…)")
    assert len(text) == 200
    assert describe(ValueError("no\nway")) == "ValueError: no way"


@pytest.mark.parametrize(("stopped_s", "passed_s"), [(4.0, 1.0), (0.5, 1.5)])
def test_a_clock_does_not_run_while_the_evaluation_is_stopped(monkeypatch, stopped_s, passed_s):
    seconds, asked = [0.0], []

    def poll(milliseconds):
        asked.append(milliseconds)
        seconds[0] += milliseconds / 1000 + stopped_s
        return [(7, 1)]

    monkeypatch.setattr(wire, "time", SimpleNamespace(monotonic=lambda: seconds[0]))
    clock = wire.RunningClock()
    assert clock.poll(SimpleNamespace(poll=poll), 3.0) == {7}
    assert asked == [1000.0]
    assert clock.now() == passed_s
