"""Checkpoints of all formats that torch and ONNX write: their bits, and files of another form."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
import safetensors.torch
import torch
from onnx import TensorProto, helper

from minitouch_bench.errors import PolicyLoadError, PolicyRaisedError
from minitouch_bench.policies.networks import TouchActor
from minitouch_bench.policies.policy import PolicySource, load_policy
from minitouch_bench.policies.policy_process import PolicyProcess
from minitouch_bench.policies.sources import parse_source
from tests.archives import members, zipped
from tests.policies.conftest import load


@pytest.fixture(scope="module")
def expected(light, observation):
    """What the actor itself gives, called as a module."""
    actor = TouchActor(5).eval()
    actor.load_state_dict(safetensors.torch.load_file(light / "policy.safetensors"))
    image = torch.from_numpy(observation["image"])[None]
    with torch.inference_mode():
        return actor(image, torch.from_numpy(observation["touch"])[None])[0].numpy()


def refused(kind, content, match):
    with pytest.raises(PolicyLoadError, match=match) as caught:
        load_policy(PolicySource(kind, "x", "x", content=content))
    assert len(str(caught.value).splitlines()) <= 2
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize(
    ("kind", "suffix"), [("native", "safetensors"), ("torchscript", "pt"), ("torch.export", "pt2")]
)
def test_a_file_gives_the_actors_own_bits(light, observation, expected, kind, suffix):
    policy = load(kind, light / f"policy.{suffix}")
    policy.reset(0, "opening")
    assert len(expected) == 5
    assert np.array_equal(np.ravel(policy.act(observation)), expected)


def test_onnx_gives_the_actors_numbers(onnx_file, observation, expected):
    policy = load("onnx", onnx_file)
    policy.reset(0, "opening")
    np.testing.assert_allclose(np.ravel(policy.act(observation)), expected, atol=1e-5)


@pytest.mark.parametrize("kind", ["random", "native", "onnx"])
def test_chance_comes_from_the_episodes_seed(light, tmp_path, observation, kind):
    (noise := tmp_path / "noise.onnx").write_bytes(onnx_bytes(noise=True))
    names = {"random": "random", "native": light / "policy.safetensors", "onnx": noise}
    drawn = []
    with PolicyProcess(replace(parse_source(str(names[kind])), deterministic=False)) as policy:
        for seed in (1, 1, 2**63 + 2):
            policy.reset(seed, "opening")
            drawn.append(policy.act(observation).tolist())
    assert drawn[0] == drawn[1] != drawn[2]


def test_native_files_of_another_form_are_refused(light):
    tensors = safetensors.torch.load_file(light / "policy.safetensors")

    def written(form, **changes):
        metadata = {"minitouch": json.dumps(form)}
        return safetensors.torch.save({**tensors, **changes}, metadata)

    form = {
        "architecture": "hac-actor-v1",
        "action_size": 5,
        "image_shape": [1, 84, 84],
        "encoder_width": 1.0,
    }
    weights_alone = safetensors.torch.save(tensors)
    refused("native", weights_alone, "save_native; of a LeRobot policy, give the directory")
    refused("native", written({**form, "architecture": "other"}), "architecture 'other'")
    refused("native", written({**form, "action_size": 10**9}), "action_size")
    refused("native", written({**form, "action_size": 4}), "size mismatch")
    refused("native", written(form, extra=torch.zeros(1)), 'Unexpected key.* "extra"')
    refused("native", written({**form, "encoder_width": 1.5}), "encoder_width")
    larger = {**form, "image_shape": [1, 96, 96]}
    refused("native", written(larger), r"trained on images of shape \(1, 96, 96\)")


IMAGE, TOUCH = torch.zeros(1, 1, 84, 84, dtype=torch.uint8), torch.ones(1, 11)


class Reach(torch.nn.Module):
    """Return what is asked for of the touch vector."""

    def forward(self, image, touch):
        return touch[:, :4]


def exported(arguments=(IMAGE, TOUCH), **options):
    buffer = io.BytesIO()
    torch.export.save(torch.export.export(Reach(), arguments, **options), buffer)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        ((IMAGE.float(), TOUCH), {}),
        ((IMAGE, TOUCH[:, :5]), {}),
        ((), {"kwargs": {"image": IMAGE, "touch": TOUCH}}),
    ],
)
def test_a_program_of_other_inputs_is_refused(arguments, options):
    content = exported(arguments, **options)
    refused("torch.export", content, r"Export \(image: uint8 \(1, 1, 84, 84\)")


def test_programs_of_another_form_are_refused():
    weights = io.BytesIO()
    torch.save({"weight": torch.zeros(3)}, weights)
    refused("torch.export", weights.getvalue(), "cannot be read")
    contents = members(exported())
    library = {"archive/data/aotinductor/model/model.so": b"\x7fELF"}
    refused("torch.export", zipped({**contents, **library}), "compiled code")
    (name,) = [name for name in contents if name.endswith("models/model.json")]
    program = json.loads(contents[name])
    program["schema_version"]["major"] += 1  # of a later torch
    version = torch.__version__.partition("+")[0]
    later = zipped({**contents, name: json.dumps(program)})
    refused("torch.export", later, f"torch {version}.* version")


class Asserting(torch.nn.Module):
    def forward(self, image, touch):
        assert touch.sum() < 0, "boom"
        return touch[:, :4]


@pytest.mark.filterwarnings("ignore:.?torch.jit:DeprecationWarning")
def test_what_a_script_says_itself_is_shown_once(tmp_path, observation):
    torch.jit.save(torch.jit.script(Asserting()), tmp_path / "policy.pt")
    with PolicyProcess(parse_source(str(tmp_path / "policy.pt"))) as policy:
        policy.reset(0, "pushing")
        with pytest.raises(PolicyRaisedError, match=r"^the policy said: (?!the policy).*boom"):
            policy.act(observation | {"touch": np.ones(11, np.float32)})


def onnx_bytes(
    inputs=("image", "touch"), output="action", image_shape=(1, 1, 84, 84), *, noise=False
):
    values = [
        helper.make_tensor_value_info(inputs[0], TensorProto.UINT8, image_shape),
        helper.make_tensor_value_info(inputs[1], TensorProto.FLOAT, ["batch", 11]),
    ]
    cuts = {"start": 0, "end": 4, "axis": 1}
    numbers = [helper.make_tensor(name, TensorProto.INT64, [1], [n]) for name, n in cuts.items()]
    kind = "RandomNormalLike" if noise else "Identity"
    source = helper.make_node(kind, [inputs[1]], ["source"])
    cut = helper.make_node("Slice", ["source", *cuts], [output])
    result = helper.make_tensor_value_info(output, TensorProto.FLOAT, ["batch", None])
    graph = helper.make_graph([source, cut], "graph", values, [result], numbers)
    opset = helper.make_opsetid("", 18)
    return helper.make_model(graph, opset_imports=[opset], ir_version=10).SerializeToString()


@pytest.mark.parametrize("kind", ["onnx", "torch.export"])
def test_a_free_batch_axis_is_fine(observation, kind):
    content = onnx_bytes()
    if kind == "torch.export":
        batch = {0: torch.export.Dim("batch", min=1)}
        two = IMAGE.repeat(2, 1, 1, 1), TOUCH.repeat(2, 1)
        content = exported(two, dynamic_shapes=(batch, batch))
    policy = load_policy(PolicySource(kind, "x", "x", content=content))
    assert np.array_equal(policy.act(observation)[0], observation["touch"][:4])


def test_onnx_files_of_another_form_are_refused():
    refused("onnx", onnx_bytes(inputs=("state", "touch")), r"inputs \['state', 'touch'\]")
    refused("onnx", onnx_bytes(output="mean"), r"outputs \['mean'\]")
    refused("onnx", onnx_bytes(image_shape=(1, 3, 84, 84)), r"is uint8 \(1, 3, 84, 84\), not uint8")
