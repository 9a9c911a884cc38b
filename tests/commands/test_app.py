import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from typer.core import TyperOption
from typer.main import get_command
from typer.testing import CliRunner

from minitouch_bench.commands.app import app
from minitouch_bench.errors import UsageError
from tests.commands.command import COMMAND, run, run_installed

USAGE = [
    (["evaluate"], "POLICY", "evaluate "),
    (["evaluate", "zero", "--act-timeout", "nan"], "--act-timeout", "evaluate "),
    (["evaluat", "zero"], "evaluate", ""),
    (["leaderboard", "chec"], "check", "leaderboard "),
]


@pytest.mark.parametrize(("arguments", "word", "command"), USAGE)
def test_wrong_usage_takes_two_lines(tmp_path, arguments, word, command):
    done = run(*arguments, directory=tmp_path)
    done.refused(2, word)
    assert done.err.endswith(f"\nSee minitouch-bench {command}--help\n")


def test_without_arguments_the_help_is_printed_as_it_is(tmp_path):
    done = run_installed(directory=tmp_path)
    assert (done.code, done.err) == (2, "")
    assert done.out == run("--help", directory=tmp_path).out
    assert "\n  evaluate  " in done.out
    assert run("shapes", directory=tmp_path).out == run("shapes", "--help", directory=tmp_path).out


COMMANDS = [
    (f"{name} {sub}".strip(), command)
    for name, one in get_command(app).commands.items()
    for sub, command in getattr(one, "commands", {"": one}).items()
]


@pytest.mark.parametrize(("name", "command"), COMMANDS, ids=[name for name, _ in COMMANDS])
def test_an_option_has_a_help_and_is_given_once_unless_that_says_otherwise(name, command):
    assert command.help
    for option in command.params:
        assert option.help, f"{name}: {option.name}"
        assert len(option.opts) == 1, option.opts
        if isinstance(option, TyperOption):
            given = [option.opts[0], *([] if option.is_flag else ["1"])]
            done = CliRunner().invoke(app, [*name.split(), *given, *given])
            refused = isinstance(done.exception, UsageError) and "2 times" in str(done.exception)
            assert refused != ("repeat" in option.help), f"{name} {option.name}: {done.output}"
            assert not refused or str(done.exception).startswith(option.opts[0])


def test_an_option_given_twice_ends_a_command_before_it_does_anything(tmp_path):
    twice = ("--tasks", "pushing", "--tasks", "opening")
    for arguments in (("--version", "--version"), ("evaluate", "zero", *twice)):
        run(*arguments, directory=tmp_path).refused(2, "is given 2 times")
    assert not list(tmp_path.iterdir())


FULL = "minitouch-bench: standard output cannot be written: No space left on device\n"


@pytest.mark.parametrize(
    ("streams", "code", "notes"), [("<&- >&- 2>&-", 0, ""), (">/dev/full", 5, FULL)]
)
def test_a_closed_or_full_stream_has_a_line_at_most_and_the_right_exit_code(streams, code, notes):
    command = f"{shlex.join(COMMAND)} --version {streams}"
    done = subprocess.run(command, check=False, shell=True, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (code, notes)


INSTALLED = [str(Path(sys.executable).with_name("minitouch-bench"))]


@pytest.mark.parametrize("command", [INSTALLED, COMMAND])
@pytest.mark.parametrize("module", ["gymnasium", "typer"])
def test_ctrl_c_while_the_command_loads_ends_it_with_a_line(tmp_path, monkeypatch, module, command):
    interrupt = "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nraise AssertionError\n"
    (tmp_path / f"{module}.py").write_text(interrupt)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    done = subprocess.run([*command, "--version"], check=False, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "minitouch-bench: interrupted\n"


@pytest.mark.parametrize(
    ("command", "code", "word"),
    [
        (("verify", "\x1b[31mred\u200b"), 6, "[31mred is"),
        (("train", "pushing", "--config=~/none.toml"), 2, "/home/none.toml"),
        (("train", "pushing", "--config", "~/none.toml"), 2, "/home/none.toml"),
        (("evaluate", os.fsdecode(b"\xff.onnx")), 2, "\\udcff.onnx' is not UTF-8"),
        (("evaluate", "zero", "--output", "a" * 300), 6, "File name too long"),
    ],
    ids=str,
)
def test_a_name_that_cannot_be_used_is_refused_in_a_line(
    tmp_path, monkeypatch, command, code, word
):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    run(*command, directory=tmp_path).refused(code, word)


def test_a_working_directory_that_was_removed_is_named_in_a_line(tmp_path):
    (tmp_path / "gone").mkdir()
    command = Path(sys.executable).with_name("minitouch-bench")
    script = ["sh", "-c", 'rmdir "$PWD" && exec "$0" tasks', command]
    done = subprocess.run(
        script, cwd=tmp_path / "gone", check=False, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "was removed" in done.stderr
