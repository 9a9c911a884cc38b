"""Files that are bombs, pickles or debris, each loaded by a real child."""

import base64
import ctypes
import io
import json
import mmap
import os
import pickle
import socket
import struct
import warnings
import zipfile
from pathlib import Path

import cloudpickle
import numpy as np
import pytest
import torch

from minitouch_bench.errors import PolicyFaultError, PolicyLoadError
from minitouch_bench.evaluation.policy_setup import try_policy
from minitouch_bench.files import ENTRY_MARK, LARGEST_CHECKPOINT
from minitouch_bench.policies.policy import Isolation, IsolationOptions
from minitouch_bench.policies.policy_process import PolicyProcess, isolate
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.protocol.limits import PolicyLimits
from tests.archives import members, zipped
from tests.policies.recipes import run_recipes
from tests.policies.test_policy import onnx_bytes

onnx = pytest.importorskip("onnx")
pytest.importorskip("stable_baselines3")


@pytest.fixture(scope="module")
def files(light, onnx_file, tmp_path_factory):
    """A good file of each format, by its suffix."""
    directory = tmp_path_factory.mktemp("sb3")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run_recipes(directory, "stable_baselines3")
    of_torch = [light / f"policy.{suffix}" for suffix in ("safetensors", "pt2", "pt")]
    return {path.suffix: path for path in (*of_torch, onnx_file, directory / "policy.zip")}


@pytest.fixture(scope="module")
def policy():
    with PolicyProcess(
        parse_source("zero"), IsolationOptions(limits=PolicyLimits(memory_mb=2048))
    ) as policy:
        yield policy


def give(policy, directory, suffix, content):
    """Have one host load file after file; it reads each once, so each has a name of its own."""
    number = len(list(directory.iterdir()))
    path = directory / f"policy-{number}{suffix}"
    path.write_bytes(content)
    policy._source = parse_source(str(path))


def refused(policy, directory, suffix, content, match=None):
    give(policy, directory, suffix, content)
    with pytest.raises(PolicyLoadError, match=match) as caught:
        policy.reset(0, "pushing")
    assert not isinstance(caught.value, PolicyFaultError)
    assert caught.value.exit_code == 3
    assert str(caught.value).replace("\n", "", 1).isprintable()
    assert len(str(caught.value)) < 600


def test_every_format_gives_the_same_bits_in_the_sandbox_and_out(files, observation):
    for path in files.values():
        actions = []
        for level in (Isolation.PROCESS, Isolation.SANDBOX):
            with isolate(
                parse_source(str(path)), IsolationOptions(level, trust=level is Isolation.PROCESS)
            ) as policy:
                policy.reset(3, "opening")
                actions.append([policy.act(observation).tobytes() for _ in range(3)])
                host = policy._host.process
                assert len(os.listdir(f"/proc/{host.pid}/task")) == 1  # else fork is unsafe
            assert host.returncode == 0  # it ended by itself, without a wait
        assert actions[0] == actions[1]


@pytest.mark.parametrize("suffix", [".safetensors", ".pt2", ".pt", ".onnx", ".zip"])
def test_debris_is_refused(policy, files, tmp_path, suffix):
    whole = files[suffix].read_bytes()
    debris = np.random.default_rng(0).bytes(5000)
    refused(policy, tmp_path, suffix, whole[: len(whole) // 2])
    refused(policy, tmp_path, suffix, debris)


def test_a_file_too_large_is_refused_unread(tmp_path):
    path = tmp_path / "policy.onnx"
    with path.open("wb") as file:
        file.truncate(LARGEST_CHECKPOINT + 1)
    with pytest.raises(PolicyLoadError, match="larger than"):
        parse_source(str(path))


class Deed:
    """Unpickled, it calls a function."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


def test_a_pickle_named_pt_is_not_opened(policy, tmp_path):
    buffer, canary = io.BytesIO(), tmp_path / "canary"
    deed = Deed(canary.touch)
    torch.save({"weights": deed}, buffer)
    for content in (buffer.getvalue(), pickle.dumps(deed)):
        refused(policy, tmp_path, ".pt", content, "Weights alone are not enough")
    assert not canary.exists()


DEEDS = {
    "read /etc/passwd": (Deed(Path.read_text, Path("/etc/passwd")), "Permission denied"),
    "open a socket": (Deed(socket.socket), "not permitted"),
    "fork": (Deed(os.fork), "not permitted"),
    "allocate 10 GB": (Deed(bytearray, 10 * 10**9), "MemoryError"),
    "share memory, which has no limit": (Deed(mmap.mmap, -1, 4096), "not permitted"),
    "read how much memory is used": (Deed(Path.read_text, Path("/proc/meminfo")), "Permission"),
    "flood its output": (Deed(exec, "while True: print('x' * 1000)"), "not loaded within 3 s"),
    "exit": (Deed(os._exit, 0), "exited with code 0"),
    "crash": (Deed(ctypes.string_at, 0), "killed by SIGSEGV"),
}
"""What is tried by the pickle of a Stable-Baselines3 model, and what is said of it.

The kernel's other answers are proven with a factory, in ``hostile_factory``.
"""


def with_class(whole, deed):
    """Return a Stable-Baselines3 zip, whose policy class is a pickle."""
    contents = members(whole)
    settings = json.loads(contents["data"])
    pickled = base64.b64encode(cloudpickle.dumps(deed)).decode()
    settings["policy_class"] = {":type:": "", ":serialized:": pickled}
    return zipped({**contents, "data": json.dumps(settings)})


@pytest.mark.parametrize("name", DEEDS)
def test_a_pickle_in_an_sb3_zip_cannot(policy, monkeypatch, files, tmp_path, name):
    deed, text = DEEDS[name]
    if "within 3 s" in text:
        monkeypatch.setattr(policy, "_limits", PolicyLimits(load_timeout_s=3.0))
    refused(policy, tmp_path, ".zip", with_class(files[".zip"].read_bytes(), deed), text)


def with_weight(whole, deed):
    """Return a program of torch.export, one of whose weights is a pickle."""
    contents = members(whole)
    (configuration,) = [name for name in contents if name.endswith("model_weights_config.json")]
    weights = json.loads(contents[configuration])
    first = next(iter(weights["config"].values()))
    first["use_pickle"] = True
    pickled = io.BytesIO()
    torch.save(deed, pickled)
    parameter = configuration.replace("model_weights_config.json", first["path_name"])
    return zipped({**contents, configuration: json.dumps(weights), parameter: pickled.getvalue()})


@pytest.mark.parametrize(("suffix", "make"), [(".zip", with_class), (".pt2", with_weight)])
def test_the_same_pickle_is_opened_in_the_sandbox_and_writes_only_out_of_it(
    policy, files, tmp_path, suffix, make
):
    canary = tmp_path / "canary"
    content = make(files[suffix].read_bytes(), Deed(canary.touch))
    refused(policy, tmp_path, suffix, content, "Permission")
    assert not canary.exists()
    source = policy._source
    with pytest.raises(PolicyLoadError):
        try_policy(source, ["pushing"], IsolationOptions(Isolation.PROCESS, trust=True))
    assert canary.exists()  # so the tests above test something


TENSOR = {"dtype": "F32", "shape": [2**32], "data_offsets": [0, 2**34]}
LARGE = json.dumps({"weight": TENSOR}).encode()


@pytest.mark.parametrize(
    "content",
    [struct.pack("<Q", 2**63) + b"{}", struct.pack("<Q", len(LARGE)) + LARGE + bytes(100)],
)
def test_safetensors_that_declare_more_than_they_hold_are_refused(policy, tmp_path, content):
    refused(policy, tmp_path, ".safetensors", content, "SafetensorError")


@pytest.mark.parametrize("suffix", [".pt2", ".pt", ".zip"])
def test_a_zip_bomb_is_not_unpacked(policy, tmp_path, suffix):
    bomb = zipped({"policy/data/0": bytes(2**26)}, zipfile.ZIP_DEFLATED)
    many = zipped({f"data/{number}": b"" for number in range(10_001)})
    listed = ENTRY_MARK * 10_002  # refused before zipfile finds that it is not one
    for content, text in (
        (bomb, f"declares {2**26}: it is not"),
        (many, "contains 10001 files"),
        (listed, "contains 10002 files"),
    ):
        with pytest.raises(PolicyLoadError, match=text):  # before any process is started
            give(policy, tmp_path, suffix, content)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"dims": [10**6, 10**6], "raw_data": b"1234"}, "it is not unpacked"),
        ({"dims": [4], "data_location": onnx.TensorProto.EXTERNAL}, "external_data=False"),
    ],
)
def test_onnx_whose_weights_are_not_in_the_file_is_refused(policy, tmp_path, fields, text):
    model = onnx.load_from_string(onnx_bytes())
    extra = onnx.TensorProto(name="extra", data_type=onnx.TensorProto.FLOAT, **fields)
    if "data_location" in fields:
        extra.external_data.add(key="location", value="../../etc/passwd")
    model.graph.initializer.append(extra)
    refused(policy, tmp_path, ".onnx", model.SerializeToString(), text)
