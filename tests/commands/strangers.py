"""Factories of policies that fail, each in another way."""

import os
import time

import numpy as np


class Policy:
    def reset(self, seed, task):
        self.task = task

    def act(self, observation):
        return np.zeros(4, np.float32)


class WrongLength(Policy):
    def act(self, observation):
        return np.zeros(3, np.float32)


class NotANumber(Policy):
    def act(self, observation):
        return np.full(4, np.nan, np.float32)


class Sleeper(Policy):
    def act(self, observation):
        time.sleep(1000)


class Leaver(Policy):
    def act(self, observation):
        os._exit(3)


class OneFaultATask(Policy):
    """Shows every fault in one run: a task each."""

    def act(self, observation):
        kinds = {
            "playing": NotANumber,
            "pushing": WrongLength,
            "opening": Sleeper,
            "pick-up": Leaver,
        }
        return kinds[self.task]().act(observation)
