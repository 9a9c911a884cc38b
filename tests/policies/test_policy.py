"""Checkpoints of all formats that torch and ONNX write: their bits, and files of another form."""

import io
import json
import os

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


@pytest.mark.parametrize("kind", ["native", "random"])
def test_chance_comes_from_the_seed(light, observation, kind):
    policy = load_policy(parse_source("random"))
    if kind == "native":
        policy = load(kind, light / "policy.safetensors", deterministic=False)
    drawn = []
    for seed in (1, 1, 2**63):
        policy.reset(seed, "opening")
        drawn.append(policy.act(observation).tolist())
    assert drawn[0] == drawn[1] != drawn[2]


def test_native_files_of_another_form_are_refused(light):
    content = (light / "policy.safetensors").read_bytes()
    tensors = safetensors.torch.load(content)

    def written(form, **changes):
        metadata = {"minitouch": json.dumps(form)}
        return safetensors.torch.save({**tensors, **changes}, metadata)

    form = {
        "architecture": "hac-actor-v1",
        "action_size": 5,
        "image_shape": [1, 84, 84],
        "encoder_width": 1.0,
    }
    refused("native", b"plain text, long enough", "not a readable native policy")
    refused("native", content[:-100], "not a readable native policy")
    refused("native", safetensors.torch.save(tensors), "save_native")
    refused("native", written({**form, "architecture": "other"}), "architecture 'other'")
    refused("native", written({**form, "action_size": 10**9}), "action_size")
    refused("native", written({**form, "action_size": 4}), "size mismatch")
    refused("native", written(form, extra=torch.zeros(1)), 'Unexpected key.* "extra"')
    refused("native", written({**form, "encoder_width": 1.5}), "encoder_width")
    larger = {**form, "image_shape": [1, 96, 96]}
    refused("native", written(larger), r"trained on images of shape \(1, 96, 96\)")


def saved_weights():
    weights = io.BytesIO()
    torch.save({"weight": torch.zeros(3)}, weights)
    return weights.getvalue()


def test_torchscript_files_of_another_form_are_refused():
    refused("torchscript", b"plain text", "not a TorchScript file")
    refused("torchscript", saved_weights(), "Weights alone are not enough")


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
    whole = exported()
    for content in (b"plain text", whole[:-500], saved_weights()):
        refused("torch.export", content, "cannot be read")
    contents = members(whole)
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


def onnx_bytes(inputs=("image", "touch"), output="action", **options):
    image_shape = options.get("image_shape", [1, 1, 84, 84])
    values = [
        helper.make_tensor_value_info(inputs[0], TensorProto.UINT8, image_shape),
        helper.make_tensor_value_info(inputs[1], TensorProto.FLOAT, ["batch", 11]),
    ]
    bound = helper.make_tensor("bound", TensorProto.INT64, [1], options.get("bound", [4]))
    constant = helper.make_node("Constant", [], ["end"], value=bound)
    start = helper.make_tensor("start", TensorProto.INT64, [1], [0])
    axis = helper.make_tensor("axis", TensorProto.INT64, [1], [1])
    kind = "RandomNormalLike" if options.get("noise") else "Identity"
    source = helper.make_node(kind, [inputs[1]], ["source"])
    cut = helper.make_node("Slice", ["source", "start", "end", "axis"], [output])
    result = helper.make_tensor_value_info(output, TensorProto.FLOAT, ["batch", None])
    graph = helper.make_graph([constant, source, cut], "graph", values, [result], [start, axis])
    return helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10
    ).SerializeToString()


@pytest.mark.parametrize("kind", ["onnx", "torch.export"])
def test_a_free_batch_axis_is_fine(observation, kind):
    content = onnx_bytes()
    if kind == "torch.export":
        batch = {0: torch.export.Dim("batch", min=1)}
        two = IMAGE.repeat(2, 1, 1, 1), TOUCH.repeat(2, 1)
        content = exported(two, dynamic_shapes=(batch, batch))
    policy = load_policy(PolicySource(kind, "x", "x", content=content))
    assert np.array_equal(policy.act(observation)[0], observation["touch"][:4])


def test_chance_in_a_graph_comes_from_the_episodes_seed(tmp_path, observation):
    path = tmp_path / "noise.onnx"
    path.write_bytes(onnx_bytes(bound=[4], noise=True))
    drawn = []
    with PolicyProcess(parse_source(str(path))) as policy:
        for seed in (1, 1, 2):
            policy.reset(seed, "pushing")
            drawn.append(policy.act(observation).tolist())
        assert policy._host is not None
        assert len(os.listdir(f"/proc/{policy._host.process.pid}/task")) == 1  # else fork is unsafe
    assert drawn[0] == drawn[1] != drawn[2]


def test_onnx_files_of_another_form_are_refused():
    refused("onnx", b"plain text", "not a readable onnx policy")
    refused("onnx", onnx_bytes(inputs=("state", "touch")), r"inputs \['state', 'touch'\]")
    refused("onnx", onnx_bytes(output="mean"), r"outputs \['mean'\]")
    refused("onnx", onnx_bytes(image_shape=[1, 3, 84, 84]), r"is uint8 \(1, 3, 84, 84\), not uint8")
