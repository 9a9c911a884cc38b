"""A training that takes seconds."""

from pathlib import Path

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


def stop_at_once(directory: Path, config: TrainingConfig = CONFIG) -> list[str]:
    """Begin or resume a training that is asked to stop before its next step; return its notes."""
    notes: list[str] = []
    callbacks = Callbacks(note=notes.append, should_stop=lambda: True)
    assert not run_training(config, directory, resume=True, device="cpu", callbacks=callbacks)
    return notes
