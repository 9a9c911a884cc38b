import pytest

from tests.cli.command import run

USAGE = [
    (["evaluate"], "POLICY"),
    (["evaluate", "zero", "--episodes", "0"], "--episodes"),
    (["evaluate", "zero", "--act-timeout", "inf"], "--act-timeout"),
    (["evaluat", "zero"], "evaluate"),
]


@pytest.mark.parametrize(("arguments", "word"), USAGE)
def test_wrong_usage_takes_two_lines(tmp_path, arguments, word):
    run(*arguments, directory=tmp_path).refused(2, word, "--help")


def test_without_arguments_there_is_help(tmp_path):
    done = run(directory=tmp_path)
    assert done.code == 2
    assert "Usage" in done.out + done.err
    assert run("--help", directory=tmp_path).code == 0


def test_a_shell_can_complete_it(tmp_path):
    done = run("--show-completion", "bash", directory=tmp_path)
    assert done.code == 0
    assert "complete" in done.out
