"""Policies that fail in every way the evaluation must survive, chosen by the episode's seed."""

import os
import signal
import sys
import time

import numpy as np

from minitouch_bench.policies.wire import HEADER, MAX_PAYLOAD, Frame

calls = 0
"""Acts so far in this process; a later episode must not see those of an earlier one."""


def sleep():
    time.sleep(1000)


def flood():
    while True:
        os.write(1, b"x" * 10_000 + b"\n")


def print_much():
    for number in range(5_000):
        print("line", number)
    return np.zeros(4)


def raise_error():
    raise ValueError("I am\nlost \x1b[31m" + "!" * 1000)


def leave_saying():
    print("last words", file=sys.stderr)
    os._exit(9)


def kill_grown():
    grown = b"x" * 400 * 2**20
    os.kill(os.getpid(), signal.SIGKILL)
    return grown


def close_pipes():
    os.closerange(3, 64)
    time.sleep(1000)


def pack_frame(kind, payload=b""):
    return HEADER.pack(kind, len(payload)) + payload


def say(*packets):
    """Write to the evaluation past the code that answers for this policy."""
    for descriptor in range(3, 64):
        try:
            for packet in packets:
                os.write(descriptor, packet)
        except OSError:
            continue


def say_only(packet):
    say(packet)
    time.sleep(1000)


def answer_ahead():
    say(*3 * [pack_frame(Frame.ACTION, np.ones(4, np.float32).tobytes())])
    return np.ones(4, np.float32)


ACTS = {
    "fine": lambda: np.full(4, 0.25, np.float32),
    "count": lambda: np.array([calls, os.getpid(), os.getppid(), 0.0]),
    "sleep": sleep,
    "flood": flood,
    "be_slow": lambda: (time.sleep(0.3), np.zeros(4))[1],
    "print_much": print_much,
    "raise": raise_error,
    "sys_exit_text": lambda: sys.exit("going home"),
    "os_exit": leave_saying,
    "kill": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "kill_grown": kill_grown,
    "close_pipes": close_pipes,
    "speak_nonsense": lambda: say_only(b"\xff" * 100),
    "speak_at_length": lambda: say_only(pack_frame(Frame.ACTION, bytes(MAX_PAYLOAD + 1))),
    "cut_short": lambda: say_only(pack_frame(Frame.ACTION, bytes(15))),
    "claim_absence": lambda: say_only(pack_frame(Frame.UNREACHABLE, b"gone")),
    "claim_refusal": lambda: say_only(pack_frame(Frame.REFUSED, b"refused")),
    "answer_ahead": answer_ahead,
    "kill_host": lambda: (os.kill(os.getppid(), signal.SIGKILL), time.sleep(1000)),
    "nan": lambda: np.full(4, np.nan),
}
SEEDS = {name: seed for seed, name in enumerate(ACTS)}
RESET_RAISES, RESET_EXITS, RESET_SLEEPS = 100, 101, 102


class Misbehaving:
    def reset(self, seed, task):
        self.act_now = list(ACTS.values())[seed] if seed < 100 else None
        if seed == RESET_RAISES:
            raise KeyError(task)
        if seed == RESET_EXITS:
            os._exit(5)
        if seed == RESET_SLEEPS:
            sleep()

    def act(self, observation):
        global calls  # noqa: PLW0603 - memory across episodes is what is tested
        calls += 1
        return self.act_now()


class Forgetful(Misbehaving):
    warning = "it forgets\nmuch"


def claiming_factory():
    say_only(pack_frame(Frame.CONFINED))


def ready_at_once():
    say(pack_frame(Frame.LOADED), pack_frame(Frame.READY))
    return Misbehaving()


def told_factory(deterministic):
    policy = Misbehaving()
    policy.act = lambda observation: np.full(4, float(deterministic))
    return policy


not_a_policy = dict
