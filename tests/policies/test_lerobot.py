"""LeRobot's checkpoints: their files without LeRobot, and their policies beside LeRobot's own."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import safetensors.numpy

from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.policies import lerobot
from minitouch_bench.policies.policy import load_policy
from minitouch_bench.policies.policy_process import PolicyProcess
from minitouch_bench.policies.sources import parse_source, read_checkpoint

CHUNK, PLAYED = 6, 3
"""Actions of a chunk, and how many of them are played."""


def load(path):
    """Load a checkpoint in this process, as its own process does."""
    source = parse_source(str(path))
    return load_policy(replace(source, content=read_checkpoint(path)))


def write_parts(folder):
    """Write a checkpoint's files, whose contents are their names."""
    folder.mkdir(parents=True)
    for name in (*lerobot.PARTS, "policy_preprocessor_step_3_normalizer_processor.safetensors"):
        (folder / name).write_text(name)
    (folder / "train_config.json").write_text("not read")
    return folder


def test_the_digest_is_that_of_what_is_read_of_the_directory(tmp_path):
    """Whatever the clock and the Python: a run that is resumed or checked elsewhere asks for it."""
    checkpoints = tmp_path / "outputs" / "act" / "checkpoints"
    write_parts(checkpoints / "000300" / "pretrained_model")
    (checkpoints / "last").symlink_to("000300")
    folder = checkpoints / "last" / "pretrained_model"
    given = parse_source(str(tmp_path / "outputs" / "act"))
    assert (given.kind, given.name, given.target) == ("lerobot", "act", str(folder))
    assert given.digest == "b75608ae1c71a2999ab065b732e627d51b00aa2b7e8e64ca7f666e4f6fb94789"
    (folder / "train_config.json").unlink()
    packed = tmp_path / "pushing.lerobot"
    packed.write_bytes(read_checkpoint(folder))
    assert parse_source(str(packed)).digest == given.digest
    (folder / lerobot.CONFIG).write_text("{}")
    assert parse_source(str(folder)).digest != given.digest


def test_a_directory_can_have_one_checkpoint_per_task(tmp_path):
    for task in ("pushing", "opening"):
        write_parts(tmp_path / "all" / task)
    source = parse_source(str(tmp_path / "all"))
    assert source.kinds == ("lerobot",)
    with pytest.raises(PolicyLoadError, match="no policy for the task 'playing'"):
        source.for_task("playing")


@pytest.mark.parametrize("name", lerobot.PARTS)
def test_a_missing_part_is_named_with_what_to_do(tmp_path, name):
    folder = write_parts(tmp_path / "x")
    (folder / name).unlink()
    (folder / "pytorch_model.bin").touch()
    with pytest.raises(PolicyLoadError, match=f"has no {name}: [^\n]+$"):
        parse_source(str(folder))


def test_a_name_that_is_too_long_is_refused_in_a_line(tmp_path):
    folder = write_parts(tmp_path / "x")
    (folder / f"policy_preprocessor_{'9' * 100}.safetensors").touch()
    with pytest.raises(PolicyLoadError, match="too long"):
        parse_source(str(folder))


# With LeRobot


class Made(NamedTuple):
    """A policy in memory with its processors, and the directory where LeRobot saved them."""

    folder: Path
    policy: Any
    before: Any
    after: Any


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A small ACT and a small Diffusion Policy with random weights, saved by LeRobot, by type."""
    install = "make test-lerobot has an environment with LeRobot"
    pytest.importorskip("lerobot.policies.factory", reason=install)
    import torch
    from lerobot.configs import FeatureType, PolicyFeature
    from lerobot.policies.factory import (
        get_policy_class,
        make_policy_config,
        make_pre_post_processors,
    )

    torch.manual_seed(0)
    kinds = {lerobot.IMAGE: FeatureType.VISUAL, lerobot.STATE: FeatureType.STATE}
    seen = {key: PolicyFeature(kind, lerobot.SEEN[key]) for key, kind in kinds.items()}
    generator = np.random.default_rng(0)
    stats = {
        key: {
            "mean": torch.from_numpy(generator.normal(size=shape).astype(np.float32)),
            "std": torch.ones(shape),
            "min": -torch.ones(shape),
            "max": torch.full(shape, 2.0),
        }
        for key, shape in {lerobot.IMAGE: (3, 1, 1), lerobot.STATE: (11,), "action": (4,)}.items()
    }
    small = {
        "act": {"dim_model": 32, "n_heads": 2, "dim_feedforward": 32, "n_encoder_layers": 1,
                "n_vae_encoder_layers": 1, "chunk_size": CHUNK, "n_action_steps": PLAYED},
        "diffusion": {"down_dims": (16, 32), "horizon": 8, "n_action_steps": PLAYED,
                      "num_inference_steps": 2},
    }  # fmt: skip
    made = {}
    for kind, settings in small.items():
        config = make_policy_config(
            kind,
            input_features=seen,
            output_features={"action": PolicyFeature(FeatureType.ACTION, (4,))},
            device="cpu",
            pretrained_backbone_weights=None,
            **settings,
        )
        policy = get_policy_class(kind)(config).eval()
        processors = make_pre_post_processors(config, dataset_stats=stats)
        folder = tmp_path_factory.mktemp("saved") / kind
        for part in (policy, *processors):
            part.save_pretrained(folder)
        table = json.loads((folder / lerobot.CONFIG).read_text())
        table |= {"device": "cuda", "pretrained_backbone_weights": "ResNet18_Weights.IMAGENET1K_V1"}
        (folder / lerobot.CONFIG).write_text(json.dumps(table))  # as most trainings leave it
        made[kind] = Made(folder, policy, *processors)
    return made


@pytest.fixture
def act(made, tmp_path):
    """A copy of the ACT's directory, to be changed."""
    return shutil.copytree(made["act"].folder, tmp_path / "act")


def play(policy, observations, seed=5):
    policy.reset(seed, "pushing")
    return np.stack([policy.act(one) for one in observations])


@pytest.fixture(scope="module")
def observations():
    generator = np.random.default_rng(1)
    return [
        {
            "image": generator.integers(0, 256, (1, 84, 84), np.uint8),
            "touch": generator.normal(size=11).astype(np.float32),
        }
        for _ in range(2 * PLAYED + 1)
    ]


@pytest.fixture(scope="module")
def expected(made, observations):
    """What LeRobot's policies do upon the observations, by their type, given as to its own."""
    import torch
    from lerobot.envs.utils import preprocess_observation

    actions = {}
    for kind, own in made.items():
        own.policy.reset()
        torch.manual_seed(5)
        actions[kind] = []
        for one in observations:
            image = np.repeat(one["image"][0][None, :, :, None], 3, axis=3)
            seen = preprocess_observation({"pixels": image, "agent_pos": one["touch"][None]})
            (action,) = own.after(own.policy.select_action(own.before(seen)))
            actions[kind].append(action.numpy())
    return {kind: np.stack(taken) for kind, taken in actions.items()}


@pytest.mark.parametrize("kind", ["act", "diffusion"])
def test_it_acts_as_in_lerobot(made, observations, expected, kind):
    import torch

    policy = load(made[kind].folder)
    torch.manual_seed(5)
    assert play(policy, observations).tobytes() == expected[kind].tobytes()
    chunks = expected[kind][:PLAYED], expected[kind][PLAYED : 2 * PLAYED]
    assert not np.array_equal(*chunks)


def test_in_the_sandbox_a_chunk_ends_with_its_episode(made, observations, expected):
    with PolicyProcess(parse_source(str(made["act"].folder))) as process:
        for _ in range(2):
            assert play(process, observations).tobytes() == expected["act"].tobytes()
        assert not np.array_equal(play(process, observations[1:])[0], expected["act"][1])


def change(file, **values):
    """Return a change of a JSON file's entries."""

    def make(folder):
        table = json.loads((folder / file).read_text())
        (folder / file).write_text(json.dumps(table | values))

    return make


def feature(kind, shape):
    return {"type": kind, "shape": shape}


OWN_STEP = {"steps": [{"class": "os.system", "config": {}}]}
LARGE = {lerobot.IMAGE: feature("VISUAL", [3, 96, 96])}


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (change(lerobot.CONFIG, type="smolvla"), "type 'smolvla'; read are act and diffusion"),
        (change(lerobot.CONFIG, use_peft=True), "PEFT"),
        (change(lerobot.CONFIG, of_next_year=1), "LeRobot 0.6.1 does not take its config.json"),
        (change(lerobot.CONFIG, input_features=LARGE), r"'observation.image' \(3, 96, 96\)"),
        (
            change(lerobot.CONFIG, output_features={"action": feature("ACTION", [7])}),
            r"shape \(7,\); here it is 4 or 5",
        ),
        (change(lerobot.CONFIG, dim_model=64), "size mismatch"),
        (change("policy_preprocessor.json", **OWN_STEP), "'os.system'"),
        (lambda folder: next(folder.glob(lerobot.STATES)).unlink(), "is missing: copy the whole"),
        (
            lambda folder: next(folder.glob(lerobot.STATES)).write_text("x"),
            "not a readable lerobot policy: SafetensorError",
        ),
        (lambda folder: (folder / lerobot.CONFIG).write_text("["), "not a readable lerobot"),
    ],
)
def test_another_checkpoint_is_refused_in_one_line(act, make, text):
    make(act)
    with pytest.raises(PolicyLoadError, match=text) as error:
        load(act)
    assert len(str(error.value).splitlines()) == 1


def test_a_renamed_observation_is_followed(act, observations, expected):
    """As of a training with ``--rename_map``."""
    renamed = "observation.images.front"
    for path in act.glob("*.json"):
        path.write_text(path.read_text().replace(f'"{lerobot.IMAGE}"', f'"{renamed}"'))
    for path in act.glob(lerobot.STATES):
        values = safetensors.numpy.load_file(path)
        values = {name.replace(lerobot.IMAGE, renamed): value for name, value in values.items()}
        safetensors.numpy.save_file(values, path)
    table = json.loads((act / "policy_preprocessor.json").read_text())
    table["steps"][0]["config"]["rename_map"] = {lerobot.IMAGE: renamed}
    (act / "policy_preprocessor.json").write_text(json.dumps(table))
    assert play(load(act), observations).tobytes() == expected["act"].tobytes()
