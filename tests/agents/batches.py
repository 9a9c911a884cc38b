"""Batches of random transitions."""

import torch

from minitouch_bench.agents.memory import Batch


def random_batch(size=8, seed=0):
    generator = torch.Generator().manual_seed(seed)

    def images():
        return torch.randint(0, 256, (size, 1, 84, 84), generator=generator, dtype=torch.uint8)

    def numbers(*shape):
        return torch.randn(*shape, generator=generator)

    return Batch(
        image=images(),
        touch=numbers(size, 11),
        action=numbers(size, 4).tanh(),
        next_image=images(),
        next_touch=numbers(size, 11),
        task_reward=numbers(size),
        discount=torch.full((size,), 0.99),
        ended=torch.zeros(size, dtype=torch.bool),
    )
