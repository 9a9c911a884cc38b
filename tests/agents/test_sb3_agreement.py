"""Stock Stable-Baselines3 SAC and ours reach the same return on a small state-based task."""

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import SAC

from minitouch_bench.agents.config import PhaseConfig, SacConfig
from minitouch_bench.agents.memory import ReplayMemory
from minitouch_bench.agents.sac import Sac

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

STEPS, RANDOM_STEPS = 5000, 200
RATE = 1e-3
SEEDS = (0, 1, 2)
NOTHING = np.zeros((1, 1, 1), np.uint8)
CONFIG = SacConfig(shift=0, target_rate=0.005, bfloat16=False)


class NoImage(torch.nn.Module):
    def forward(self, image):
        return image.flatten(1)[:, :0].float()


def mean_return(act, seed):
    environment = gymnasium.make("Pendulum-v1")
    returns = []
    for episode in range(20):
        observation, _ = environment.reset(seed=1000 * (seed + 1) + episode)
        returns.append(0.0)
        ended = False
        while not ended:
            observation, reward, _, ended, _ = environment.step(act(observation))
            returns[-1] += float(reward)
    return np.mean(returns)


def train_ours(seed):
    torch.manual_seed(seed)
    environment = gymnasium.make("Pendulum-v1")
    sac = Sac(CONFIG, action_size=1, touch_size=3, encoder=NoImage(), features=0)
    sac.begin_phase(PhaseConfig(STEPS, learning_rate=RATE, initial_temperature=1.0))
    noise, rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
    memory = ReplayMemory(STEPS * 2, 3, 1)

    def tensors(observation):
        return torch.from_numpy(NOTHING)[None], torch.from_numpy(observation)[None]

    observation, _ = environment.reset(seed=seed)
    memory.begin_episode(NOTHING, observation)
    for step in range(STEPS):
        if step < RANDOM_STEPS:
            action = rng.uniform(-1, 1, 1).astype(np.float32)
        else:
            action = sac.act(*tensors(observation), noise)[0].numpy()
        observation, reward, _, ended, _ = environment.step(2.0 * action)
        memory.add(action, float(reward), NOTHING, observation, success=False, ended=False)
        if ended:
            observation, _ = environment.reset()
            memory.begin_episode(NOTHING, observation)
        if step >= RANDOM_STEPS:
            batch = memory.sample(
                rng, CONFIG.batch_size,
                n_step=1, discount=0.99, success_share=0.0, device=torch.device("cpu"),
            )  # fmt: skip
            sac.update(batch, batch.task_reward, noise, 0)

    def act(observation):
        with torch.no_grad():
            image, state = tensors(observation)
            return 2.0 * sac.actor(NoImage()(image), state)[0].numpy()

    return mean_return(act, seed)


def train_stock(seed):
    model = SAC(
        "MlpPolicy",
        "Pendulum-v1",
        learning_rate=RATE,
        batch_size=CONFIG.batch_size,
        learning_starts=RANDOM_STEPS,
        policy_kwargs={"net_arch": [128, 128], "activation_fn": torch.nn.LeakyReLU},
        seed=seed,
        device="cpu",
    )
    model.learn(STEPS)
    return mean_return(lambda seen: model.predict(seen, deterministic=True)[0], seed)


def test_same_return_within_its_spread():
    torch.set_num_threads(1)
    ours = np.array([train_ours(seed) for seed in SEEDS])
    stock = np.array([train_stock(seed) for seed in SEEDS])
    print("ours", ours, "stock", stock)
    spread = max(ours.std(ddof=1), stock.std(ddof=1), 10.0)
    assert abs(ours.mean() - stock.mean()) < 3 * spread
    assert ours.mean() > -300  # random actions: about -1200
