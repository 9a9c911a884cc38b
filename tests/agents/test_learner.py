"""A learner: what it saves acts as what it learned."""

import torch

from minitouch_bench.agents.config import SacConfig, TrainingConfig
from minitouch_bench.agents.learner import Learner
from minitouch_bench.policies.networks import ENCODER_CHANNELS
from minitouch_bench.protocol.minitouch import PROTOCOL
from tests.agents.batches import random_batch


def test_a_narrow_encoder_is_saved_as_the_tables_and_acts_the_same():
    config = TrainingConfig("pushing", sac=SacConfig(encoder_width=0.25, bfloat16=False))
    learner = Learner(config, PROTOCOL.task("pushing"), torch.device("cpu"))
    batch = random_batch()
    with torch.no_grad():
        features = learner.sac.encoder(batch.image)
        mean, _ = learner.sac.actor.gaussian_of(features, learner.scale.scaled(batch.touch))
        saved = learner.actor()
        action = saved(batch.image, batch.touch)
    assert learner.sac.encoder.convolutions[0].out_channels < ENCODER_CHANNELS[0]
    assert saved.encoder.convolutions[0].out_channels == ENCODER_CHANNELS[0]
    torch.testing.assert_close(action, torch.tanh(mean), atol=1e-5, rtol=0)
