import signal
import subprocess
import sys
import time

import numpy as np
import pytest

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


WAITS = """
import os, time
from minitouch_bench.policies.wire import CLOCK, OutputPipe, wait_for
silent, _ = os.pipe()
began = time.monotonic()
print("waits", flush=True)
assert not wait_for((silent,), OutputPipe(), CLOCK.now() + 3.0)
print(time.monotonic() - began)
"""


def test_a_deadline_does_not_run_while_the_evaluation_is_stopped():
    with subprocess.Popen([sys.executable, "-c", WAITS], stdout=subprocess.PIPE, text=True) as one:
        assert one.stdout.readline() == "waits\n"
        time.sleep(0.5)  # it waits now
        one.send_signal(signal.SIGSTOP)
        time.sleep(4.0)
        one.send_signal(signal.SIGCONT)
        took = float(one.stdout.read())
    assert took > 5.9  # 3 s, and the stop less the one second of it that counts
