"""A training that takes seconds."""

import contextlib
import csv
import itertools

from minitouch_bench.agents.config import CuriosityConfig, PhaseConfig, SacConfig, TrainingConfig
from minitouch_bench.agents.training_directory import run_training
from minitouch_bench.evaluation.engine import Callbacks

CONFIG = TrainingConfig(
    "pushing",
    random_steps=10,
    log_every=5,
    evaluate_every=40,
    evaluate_episodes=1,
    checkpoint_every=7,
    exploration=PhaseConfig(30),
    task_phase=PhaseConfig(
        20,
        n_step=3,
        success_share=0.25,
        keypoint_updates=3,
        fitting_updates=3,
        prior_weight=0.5,
        prior_steps=10,
    ),
    sac=SacConfig(batch_size=4),
    curiosity=CuriosityConfig(width=0.25),
)


class KilledError(Exception):
    """Stands for a kill: nothing is saved on the way out."""


def break_off(directory, after, config=CONFIG, *, kill=False, **options):
    """Begin or resume a training that is asked to stop, or killed, ``after`` some control steps."""
    asked = itertools.count()

    def should_stop():
        is_due = next(asked) == after
        if is_due and kill:
            raise KilledError
        return is_due

    callbacks = Callbacks(should_stop=should_stop)
    options = {"resume": True, "device": "cpu", **options}
    with contextlib.suppress(KilledError):
        assert not run_training(config, directory, callbacks=callbacks, **options)


def rows(directory):
    """Return the rows that there are, without their seconds."""
    file = directory / "progress.csv"
    table = csv.DictReader(file.read_text().splitlines() if file.exists() else ())
    return [{**row, "seconds": ""} for row in table]


def outcome(directory):
    """Return what must not depend on interruptions: every row but its seconds, the policies."""
    policies = (directory / f"{one}.safetensors" for one in ("exploration", "final"))
    return rows(directory), [policy.read_bytes() for policy in policies]
