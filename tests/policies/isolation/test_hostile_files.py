"""Files that are bombs, pickles or debris, each loaded by a real child."""

import base64
import io
import json
import pickle
import struct
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch

from minitouch_bench.errors import PolicyFaultError, PolicyLoadError
from minitouch_bench.policies.isolate import isolate
from minitouch_bench.policies.isolation.options import Isolation, IsolationOptions
from minitouch_bench.policies.limits import PolicyLimits
from minitouch_bench.policies.policy import zero_observation
from minitouch_bench.policies.process import PolicyProcess
from minitouch_bench.policies.sources import MAX_FILE_BYTES, parse_source
from tests.policies.isolation import hostile_modules
from tests.policies.recipes import run_recipes

onnx = pytest.importorskip("onnx")
cloudpickle = pytest.importorskip("cloudpickle")
pytest.importorskip("stable_baselines3")

SUFFIXES = {"native": "safetensors", "torchscript": "pt", "onnx": "onnx", "sb3": "zip"}


class Canary:
    """Unpickled, it writes a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.write_text, (self.path, "sung")


@pytest.fixture
def canary(tmp_path):
    path = tmp_path / "canary"
    yield path
    assert not path.exists()


@pytest.fixture(scope="module")
def files(light, onnx_file, tmp_path_factory):
    """A good file of each format."""
    directory = tmp_path_factory.mktemp("sb3")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run_recipes(directory, "stable_baselines3")
    return {
        "native": light / "policy.safetensors",
        "torchscript": light / "policy.pt",
        "onnx": onnx_file,
        "sb3": directory / "policy.zip",
    }


@pytest.fixture(scope="module")
def policy():
    with PolicyProcess(
        parse_source("zero"), IsolationOptions(limits=PolicyLimits(memory_mb=2048))
    ) as policy:
        yield policy


def give(policy, directory, kind, content):
    """Have one host load file after file; it reads each once, so each has a name of its own."""
    number = len(list(directory.iterdir()))
    path = directory / f"policy-{number}.{SUFFIXES[kind]}"
    path.write_bytes(content)
    policy._source = parse_source(str(path))


def refused(policy, directory, kind, content, match=None):
    give(policy, directory, kind, content)
    with pytest.raises(PolicyLoadError, match=match) as caught:
        policy.reset(0, "pushing")
    assert not isinstance(caught.value, PolicyFaultError)
    assert caught.value.exit_code == 3
    assert len(str(caught.value).splitlines()) <= 2
    assert len(str(caught.value)) < 600


def members(path):
    with zipfile.ZipFile(path) as archive:
        return {info.filename: archive.read(info) for info in archive.infolist()}


def zipped(contents, method=zipfile.ZIP_STORED):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in contents.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def test_every_format_gives_the_same_bits_in_the_sandbox_and_out(files, observation):
    for path in files.values():
        actions = []
        for level in (Isolation.PROCESS, Isolation.SANDBOX):
            with isolate(
                parse_source(str(path)), IsolationOptions(level, trust="pt" in path.name)
            ) as policy:
                policy.reset(3, "opening")
                actions.append([policy.act(observation).tobytes() for _ in range(3)])
        assert actions[0] == actions[1]


@pytest.mark.parametrize("kind", SUFFIXES)
def test_debris_is_refused(policy, files, tmp_path, kind):
    whole = files[kind].read_bytes()
    debris = np.random.default_rng(0).bytes(5000)
    refused(policy, tmp_path, kind, whole[: len(whole) // 2])
    refused(policy, tmp_path, kind, debris)


@pytest.mark.parametrize("kind", SUFFIXES)
def test_a_file_too_large_is_refused_unread(tmp_path, kind):
    path = tmp_path / f"policy.{SUFFIXES[kind]}"
    with path.open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)
    with pytest.raises(PolicyLoadError, match="larger than 1 GiB"):
        parse_source(str(path))


def test_a_pickle_named_pt_is_not_opened(policy, tmp_path, canary):
    buffer = io.BytesIO()
    torch.save({"weights": Canary(canary)}, buffer)
    refused(policy, tmp_path, "torchscript", buffer.getvalue(), "no TorchScript file")
    refused(policy, tmp_path, "torchscript", pickle.dumps(Canary(canary)), "no TorchScript file")


def test_a_pickle_inside_a_script_is_not_opened(policy, files, tmp_path, canary):
    contents = members(files["torchscript"])
    name = next(name for name in contents if name.endswith("data.pkl"))
    contents[name] = pickle.dumps(Canary(canary), protocol=2)
    refused(policy, tmp_path, "torchscript", zipped(contents))


def test_pickles_in_sb3s_settings_are_not_opened(policy, files, tmp_path, canary):
    contents = members(files["sb3"])
    settings = json.loads(contents["data"])
    song = base64.b64encode(cloudpickle.dumps(Canary(canary))).decode()
    for section in settings.values():
        if isinstance(section, dict) and ":serialized:" in section:
            section[":serialized:"] = song
    give(policy, tmp_path, "sb3", zipped({**contents, "data": json.dumps(settings)}))
    policy.reset(0, "pushing")


def test_pickles_as_sb3s_weights_are_not_opened(policy, files, tmp_path, canary):
    buffer = io.BytesIO()
    torch.save({"weights": Canary(canary)}, buffer)
    contents = {**members(files["sb3"]), "policy.pth": buffer.getvalue()}
    refused(policy, tmp_path, "sb3", zipped(contents), "no plain weights")


def test_a_pickle_in_safetensors_metadata_is_not_opened(policy, tmp_path, canary):
    song = base64.b64encode(pickle.dumps(Canary(canary))).decode()
    metadata = {"minitouch": song, "__reduce__": song}
    content = safetensors.torch.save({"weight": torch.zeros(1)}, metadata)
    refused(policy, tmp_path, "native", content, "no native checkpoint")


def test_what_is_not_safetensors_is_called_damaged(policy, tmp_path):
    for content in (b"ab", b"random bytes", struct.pack("<Q", 2) + b"[}"):
        refused(policy, tmp_path, "native", content, "damaged: it is not safetensors|header of")


def test_a_header_longer_than_its_file_is_refused(policy, tmp_path):
    for length in (2**63, 2**40, 10_000):
        content = struct.pack("<Q", length) + b"{}"
        refused(policy, tmp_path, "native", content, f"header of {length} bytes")


def test_tensors_that_declare_more_than_the_file_are_refused(policy, tmp_path):
    metadata = {"minitouch": '{"architecture": "hac-actor-v1", "action_size": 5}'}
    tensor = {"dtype": "F32", "shape": [2**32], "data_offsets": [0, 2**34]}
    header = json.dumps({"__metadata__": metadata, "weight": tensor}).encode()
    content = struct.pack("<Q", len(header)) + header + bytes(100)
    refused(policy, tmp_path, "native", content, "damaged")


@pytest.mark.parametrize("kind", ["torchscript", "sb3"])
def test_a_zip_bomb_is_not_unpacked(policy, files, tmp_path, kind):
    bomb = zipped({"policy/data/0": bytes(2**26)}, zipfile.ZIP_DEFLATED)
    refused(policy, tmp_path, kind, bomb, f"declares {2**26}: it is not unpacked")
    many = zipped({f"data/{number}": b"" for number in range(10_001)})
    refused(policy, tmp_path, kind, many, "holds 10001 files")


def graph(nodes=(), initializers=(), sparse=()):
    """Return an ONNX file that gives the first of what is felt, plus ``extra`` if it is made."""
    helper, kinds = onnx.helper, onnx.TensorProto
    cut = [
        helper.make_tensor(name, kinds.INT64, [1], [value])
        for name, value in (("from", 0), ("to", 4), ("axis", 1))
    ]
    last = helper.make_node("Slice", ["touch", "from", "to", "axis"], ["cut"])
    total = helper.make_node("Add", ["cut", "extra"], ["action"])
    made = helper.make_graph(
        [*nodes, last, total],
        "graph",
        [
            helper.make_tensor_value_info("image", kinds.UINT8, [1, 1, 84, 84]),
            helper.make_tensor_value_info("touch", kinds.FLOAT, [1, 11]),
        ],
        [helper.make_tensor_value_info("action", kinds.FLOAT, None)],
        [*cut, *initializers],
        sparse_initializer=list(sparse),
    )
    opset = helper.make_opsetid("", 18)
    return helper.make_model(made, opset_imports=[opset], ir_version=10).SerializeToString()


def test_onnx_that_declares_more_than_it_holds_is_refused(policy, tmp_path):
    kinds = onnx.TensorProto
    huge = kinds(name="extra", data_type=kinds.FLOAT, dims=[10**6, 10**6], raw_data=b"1234")
    refused(policy, tmp_path, "onnx", graph(initializers=[huge]), "it is not unpacked")
    values = onnx.helper.make_tensor("extra", kinds.FLOAT, [1], [1.0])
    places = onnx.helper.make_tensor("", kinds.INT64, [1], [0])
    sparse = onnx.helper.make_sparse_tensor(values, places, [10**10])
    refused(policy, tmp_path, "onnx", graph(sparse=[sparse]), "it is not unpacked")


def test_onnx_that_grows_when_it_is_optimised_gets_no_memory(policy, tmp_path):
    shape = onnx.helper.make_tensor("shape", onnx.TensorProto.INT64, [1], [25 * 10**8])
    grow = onnx.helper.make_node("ConstantOfShape", ["shape"], ["large"])
    add = onnx.helper.make_node("ReduceSum", ["large"], ["extra"])
    give(policy, tmp_path, "onnx", graph([grow, add], [shape]))
    with pytest.raises((PolicyLoadError, PolicyFaultError), match=r"(?i)alloc|memory|bfc_arena"):
        play_one_step(policy)


def play_one_step(policy):
    policy.reset(0, "pushing")
    policy.act(zero_observation())


@pytest.mark.parametrize("where", ["secret.bin", "/etc/passwd", "../../etc/passwd"])
def test_onnx_that_keeps_weights_elsewhere_is_refused(policy, tmp_path, where):
    kinds = onnx.TensorProto
    extra = kinds(name="extra", data_type=kinds.FLOAT, dims=[4], data_location=kinds.EXTERNAL)
    extra.external_data.add(key="location", value=where)
    refused(policy, tmp_path, "onnx", graph(initializers=[extra]), "external_data=False")


def test_a_script_that_is_cut_short_inside_runs_nothing(policy, tmp_path, canary):
    whole = hostile_modules.saved(hostile_modules.WritesAtLoad(str(canary)))
    for share in (0.25, 0.5, 0.9):
        refused(policy, tmp_path, "torchscript", whole[: int(share * len(whole))])
