import json
from dataclasses import replace

import pytest

from minitouch_bench.files import ACTIONS_FILE
from tests.commands.command import run, succeed
from tests.reporting.synthetic import make_run
from tests.reporting.synthetic import write as write_run


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    directory = tmp_path_factory.mktemp("runs")

    def write(name, *, policy="", **options):
        run = make_run(name, exploration=False, **options)
        known = replace(run.header.policy, digest=policy or run.header.policy.digest)
        write_run(replace(run, header=replace(run.header, policy=known)), directory / name)

    for side, skill in (("a", 0.9), ("b", 0.2)):
        write(side, skill=skill)
        for seed in range(3):
            write(f"{side}{seed}", skill=skill, seed=seed, policy=f"{side}{seed}" * 32)
    (directory / "b" / ACTIONS_FILE).touch()  # what can be replayed
    write("c", skill=0.9, seed=4)
    write("few", episodes=4)
    write("other", digest="0123456789")
    return directory


def test_three_runs_are_compared_and_written(runs, tmp_path):
    files = ("--output", tmp_path / "page", "--html", tmp_path / "page.html")
    done = succeed("compare", "a", "b", "c", *files, directory=runs)
    for words in ("B against A", "C against A", "A is better", "minitouch-bench replay b "):
        assert words in done.out
    assert "comparison.md" in done.err
    assert "What C gains and loses" in (tmp_path / "page.html").read_text()
    assert (tmp_path / "page" / "comparison.md").read_text().startswith("# Comparison of runs")
    document = json.loads((tmp_path / "page" / "comparison.json").read_text())
    again = run("compare", "a", "b", "c", "--json", directory=runs)
    assert json.loads(again.out) == document


def methods(*, a=range(3), b=range(3)):
    """The options of two methods, by their training seeds."""
    return [word for side, seeds in (("a", a), ("b", b)) for seed in seeds
            for word in (f"--{side}", f"{side}{seed}")]  # fmt: skip


def test_two_methods_are_compared_by_their_training_seeds(runs, tmp_path):
    done = succeed("compare", *methods(), "--output", tmp_path / "page", directory=runs)
    assert "A is better: mean success A " in done.out.splitlines()[-1]
    document = json.loads((tmp_path / "page" / "comparison.json").read_text())
    again = run("compare", *methods(), "--json", directory=runs)
    assert json.loads(again.out) == document
    assert (tmp_path / "page" / "comparison.md").read_text().startswith("# Comparison of methods")


REFUSED = [
    ((), 2, "2 to 26"),
    (("a", *methods()), 2, "either RUN"),
    (methods(a=()), 2, "--a names 0"),
    (methods(b=(1, 1)), 2, "one training"),
    (("a", "few"), 2, "episodes"),
    (("a", "other"), 2, "protocols"),
    (("a", "gone"), 6, "gone"),
    (("a", "b", "--output", "a/run.json/x"), 6, "written"),
    (("a", "b", "--html", "page.pdf"), 2, ".html"),
]


@pytest.mark.parametrize(("arguments", "code", "word"), REFUSED)
def test_what_cannot_be_compared_is_refused_with_the_reason(runs, arguments, code, word):
    run("compare", *arguments, directory=runs).refused(code, word)
