"""Policies on the Hub, from a stand-in server that speaks as much of its protocol as they need."""

import hashlib
import json
import re
import sys
import threading
import tomllib
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace

import pytest

from minitouch_bench.commands.submit import submit
from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.leaderboard import packing
from minitouch_bench.policies.sources import HubFile, parse_hub_address
from tests.commands.command import run, run_installed, succeed
from tests.leaderboard.playing import write_policy

COMMIT = "0123456789abcdef0123456789abcdef01234567"
REFERENCE, TAGGED, UNKNOWN = (
    f"hf://somebody/touch@{revision}/nets/pushing.safetensors" for revision in (COMMIT, "v1", "v2")
)
ADDRESS = "hf://somebody/touch/nets/pushing.safetensors"
ONE = ("--episodes-from", "pushing/0", "--workers", "1")


@pytest.fixture
def hub(tmp_path, monkeypatch):
    """A server with one file at one commit, called main and v1: what it serves and was asked."""
    pytest.importorskip("huggingface_hub", reason="needs the extra hub")
    content = write_policy(tmp_path / "served.safetensors").read_bytes()
    served = SimpleNamespace(content=content, size=len(content), asked=[])

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            if self.do_HEAD():
                self.wfile.write(content)

        def do_HEAD(self):
            served.asked.append(self.path)
            path = r"/somebody/touch/resolve/(main|v1|0123.*)/nets/pushing.safetensors(\?.*)?"
            is_there = bool(re.fullmatch(path, self.path))
            self.send_response(200 if is_there else 404)
            self.send_header("X-Repo-Commit", COMMIT)
            self.send_header("ETag", f'"{hashlib.sha256(content).hexdigest()}"')
            self.send_header("Content-Length", str(served.size if is_there else 0))
            if not is_there:
                self.send_header("X-Error-Code", "EntryNotFound")
            self.end_headers()
            return is_there

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address, home = f"http://127.0.0.1:{server.server_port}", tmp_path / "home"
    monkeypatch.setenv("HF_ENDPOINT", address)
    monkeypatch.setenv("HF_HOME", str(home))
    # The library reads the variables once, when it is loaded.
    constants = "huggingface_hub.constants"
    paths = "/{repo_id}/resolve/{revision}/{filename}"
    monkeypatch.setattr(f"{constants}.ENDPOINT", address)
    monkeypatch.setattr(f"{constants}.HUGGINGFACE_CO_URL_TEMPLATE", address + paths)
    monkeypatch.setattr(f"{constants}.HF_HUB_CACHE", str(home / "hub"))
    yield served
    server.shutdown()
    server.server_close()


def test_a_policy_on_the_hub_is_evaluated_and_its_commit_and_digest_are_kept(hub, tmp_path):
    succeed("evaluate", TAGGED, *ONE, "--output", "run", directory=tmp_path)
    text = (tmp_path / "run" / "run.json").read_text()
    policy = json.loads(text)["header"]["policy"]
    assert policy["source"] == REFERENCE
    assert policy["digest"] == hashlib.sha256(hub.content).hexdigest()
    assert policy["kind"] == "native"
    assert str(tmp_path) not in text
    assert f"evaluate {REFERENCE}" in (tmp_path / "run" / "report.html").read_text()
    asked = list(hub.asked)
    unnamed = run("verify", "run", "--rerun", 1, directory=tmp_path)
    unnamed.refused(5, REFERENCE, "only if you name it", "--policy")
    assert hub.asked == asked
    named = ("--rerun", 1, "--policy", policy["source"])
    succeed("verify", "run", *named, directory=tmp_path)
    succeed("evaluate", ADDRESS, *ONE, "--output", "run", "--resume", directory=tmp_path)


@pytest.fixture
def submitted(hub, tmp_path, monkeypatch):
    """A submission that references the file of the Hub by its commit."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(packing, "_try_policies", lambda *_: None)
    submit([ADDRESS], name="mine", training_steps=0)
    return Path("submissions/mine")


def test_a_checkpoint_on_the_hub_is_submitted_by_reference_and_played(hub, submitted, tmp_path):
    file = tomllib.loads((submitted / "submission.toml").read_text())["trainings"][0]
    (file,) = file["checkpoints"]
    assert file["address"] == REFERENCE
    assert file["sha256"] == hashlib.sha256(hub.content).hexdigest()
    assert not list(submitted.rglob("*.safetensors"))
    succeed("leaderboard", "check", "mine", directory=tmp_path)
    succeed("evaluate", submitted / "seed-0", *ONE, "--output", "run", directory=tmp_path)
    policy = json.loads((tmp_path / "run" / "run.json").read_text())["header"]["policy"]
    assert policy["digest"] == file["sha256"]


def test_another_file_on_the_hub_is_refused_and_a_hub_out_of_reach_is_no_fault(
    submitted, tmp_path, monkeypatch
):
    file = submitted / "submission.toml"
    file.write_text(re.sub('sha256 = "[0-9a-f]{64}"', f'sha256 = "{"0" * 64}"', file.read_text()))
    done = run("leaderboard", "play", "mine", directory=tmp_path)
    assert done.code == 5
    assert "waiting" in done.out
    assert done.out.endswith("its SHA-256 is not that of submission.toml\n")
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
    monkeypatch.setenv("HF_HOME", str(tmp_path / "empty"))
    done = run_installed("leaderboard", "play", "mine", directory=tmp_path)
    assert done.code == 5
    assert "cannot be fetched" in done.err


def test_a_file_that_is_too_large_or_missing_is_not_fetched(hub, tmp_path):
    hub.size = 10**12
    done = run("evaluate", ADDRESS, *ONE, directory=tmp_path)
    done.refused(3, "1000000000000 bytes", "too large")
    assert sum("/resolve/" in path for path in hub.asked) == 1
    done = run("evaluate", UNKNOWN, *ONE, directory=tmp_path)
    done.refused(3, "@v2", "cannot be fetched")


def test_addresses():
    assert parse_hub_address("hf://a/b/c/d.onnx") == HubFile("a/b", "c/d.onnx", "main")
    assert parse_hub_address("hf://a/b@refs/pr/1/c.pt") == HubFile("a/b", "c.pt", "refs/pr/1")
    assert str(parse_hub_address(REFERENCE)) == REFERENCE
    for wrong in ("hf://a/b/../../../x.onnx", "hf://a/b", "hf://a/b/c.pt@v2", "hf://a b/c/d.pt"):
        with pytest.raises(PolicyLoadError, match="hf://USER/REPO@REVISION/FILE"):
            parse_hub_address(wrong)


def test_another_kind_of_file_and_a_missing_library_are_refused(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    for address, word in (("hf://a/b/c.txt", "no known policy"), (ADDRESS, "minitouch-bench[hub]")):
        run("evaluate", address, directory=tmp_path).refused(3, word)
