"""A training that takes seconds."""

from minitouch_bench.agents.config import CuriosityConfig, PhaseConfig, SacConfig, TrainingConfig

CONFIG = TrainingConfig(
    "pushing",
    random_steps=10,
    log_every=5,
    evaluate_every=40,
    evaluate_episodes=1,
    checkpoint_every=7,
    carry=("encoder", "actor"),
    exploration=PhaseConfig(30),
    task_phase=PhaseConfig(20, n_step=3, success_share=0.25),
    sac=SacConfig(batch_size=4),
    curiosity=CuriosityConfig(width=0.25),
)
