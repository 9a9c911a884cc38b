import numpy as np
import pytest

from minitouch_bench.errors import describe, plain_line
from minitouch_bench.policies.wire import WireError, pack_observation, unpack_observation


def test_observation_survives(observation):
    payload = pack_observation(observation)
    assert len(payload) == 7056 + 44
    back = unpack_observation(payload)
    assert np.array_equal(back["image"], observation["image"])
    assert np.array_equal(back["touch"], observation["touch"])
    back["image"][0, 0, 0] = 1  # a policy may write into its copy


def test_observation_of_another_form_is_refused(observation):
    with pytest.raises(ValueError, match="image"):
        pack_observation({**observation, "image": observation["image"][0]})
    with pytest.raises(ValueError, match="touch"):
        pack_observation({**observation, "touch": observation["touch"].astype(float)})
    with pytest.raises(WireError):
        unpack_observation(b"123")


def test_text_of_a_policy_becomes_one_plain_line():
    text = "a\x1b[31mred\x1b[0m\r\nb\x07\u202ec\t\x1b]0;title\x07d"
    assert plain_line(text) == "ared bc d"
    assert len(plain_line("x" * 100_000)) == 200


def test_an_exception_that_cannot_speak_is_still_named():
    class MuteError(Exception):
        def __str__(self):
            raise RuntimeError

    assert describe(MuteError()) == "MuteError"
    assert describe(ValueError("no\nway")) == "ValueError: no way"
    assert describe(ValueError()) == "ValueError"
