"""``minitouch-bench evaluate``: the main job."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer

from minitouch_bench.cli.consoles import data_console, notes
from minitouch_bench.cli.contests import Holding, make_contest
from minitouch_bench.cli.engines import EngineName, Place, choose_engine
from minitouch_bench.cli.progress import EvaluationProgress
from minitouch_bench.errors import InfrastructureError, InterruptedRunError
from minitouch_bench.evaluation.evaluation import Begun, Request, begin
from minitouch_bench.evaluation.evaluation import evaluate as run_evaluation
from minitouch_bench.evaluation.filming import film, film_name
from minitouch_bench.evaluation.storage import lock_directory, write_actions
from minitouch_bench.evaluation.suites import find_suite, parse_tasks
from minitouch_bench.metrics import summarize
from minitouch_bench.policies.isolation.levels import Isolation
from minitouch_bench.policies.process import PolicyLimits
from minitouch_bench.records import EvaluationRun, Outcome, SavedRun
from minitouch_bench.reporting import Report, show_report, write_report, write_run
from minitouch_bench.reporting.json_document import to_text

FINISHED_WITH_FAULTS = 4
MAX_EPISODES = 100_000
MAX_ACT_TIMEOUT_S = 86400.0


def evaluate(
    policy: Annotated[
        str,
        typer.Argument(
            metavar="POLICY",
            help="random, zero, scripted, a checkpoint (.safetensors .pt .ts .onnx .zip), a "
            "directory with one file a task, package.module:attribute, or http://...",
        ),
    ],
    *,
    suite: Annotated[str, typer.Option(help="table4, novel-shapes or smoke.")] = "table4",
    tasks: Annotated[str | None, typer.Option(help="Only these, separated by commas.")] = None,
    exploration: Annotated[
        str | None, typer.Option(help="The policy as of the end of the exploration phase.")
    ] = None,
    episodes: Annotated[
        int | None, typer.Option(min=1, max=MAX_EPISODES, help="Episodes a task.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Away from 0 the run is unofficial.")] = 0,
    workers: Annotated[str, typer.Option(help="Worker processes, or auto: one a core.")] = "auto",
    engine: Annotated[
        EngineName, typer.Option(help="local, or ray for a cluster: see docs/cluster.md.")
    ] = EngineName.LOCAL,
    address: Annotated[
        str | None,
        typer.Option(metavar="HOST:PORT", help="The Ray cluster; without it Ray starts here."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="The run's directory; by default reports/POLICY-SUITE.")
    ] = None,
    video: Annotated[int, typer.Option(min=0, help="Film the first N episodes of each task.")] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the run there.")] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Replace the run there.")] = False,
    isolation: Annotated[
        Isolation,
        typer.Option(help="How the policy is held: see docs/isolation.md. none needs --trust."),
    ] = Isolation.SANDBOX,
    trust: Annotated[
        bool, typer.Option("--trust", help="Run a policy's own Python code on this machine.")
    ] = False,
    act_timeout: Annotated[
        float,
        typer.Option(
            min=0.01, max=MAX_ACT_TIMEOUT_S, help="Seconds a policy may take for one action."
        ),
    ] = PolicyLimits().act_timeout_s,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print run.json in place of the tables.")
    ] = False,
) -> None:
    """Run a policy through the suite and write its Table-4 report."""
    published = find_suite(suite)
    chosen = parse_tasks(tasks, published)
    chosen_engine = choose_engine(engine, address, workers)
    limits = PolicyLimits(act_timeout_s=act_timeout)
    request = Request(
        suite=published,
        tasks=chosen,
        episodes=episodes or published.episodes_per_task,
        seed=seed,
        contest=make_contest(policy, exploration, chosen, Holding(limits, isolation, trust)),
    )
    directory = output or Path("reports") / run_name(request)
    with chosen_engine as place, lock_directory(directory):
        begun = begin(request, directory, resume=resume, fresh=fresh)
        if begun.torn:
            notes.print("the journal's last line was torn and has been cut off", markup=False)
        run = run_episodes(request, begun, directory, place)
        _report(run, directory, video, as_json=as_json)
    if any(record.outcome is Outcome.POLICY_FAULT for record in run.records):
        raise typer.Exit(FINISHED_WITH_FAULTS)


def run_name(request: Request) -> str:
    """Name a run's directory after its policy and suite, in harmless characters."""
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", request.contest.policy.name).strip(".-")
    return f"{name[:80] or 'policy'}-{request.suite.name}"


def run_episodes(request: Request, begun: Begun, directory: Path, place: Place) -> EvaluationRun:
    """Run what is missing, with a progress display; what is done survives a break."""
    suite = request.chosen()
    total = len(suite.episodes(exploration=request.contest.exploration is not None))
    with resumable(directory), EvaluationProgress(total, notes) as progress:
        for record in begun.records:
            progress.add(record)
        return run_evaluation(
            request, place.engine, begun, directory, progress.add, workers=place.workers
        )


@contextmanager
def resumable(directory: Path) -> Iterator[None]:
    """Tell the user of a run that is broken off how to go on."""
    try:
        yield
    except InfrastructureError as error:
        raise InfrastructureError(f"{error}\n{how_to_go_on(directory)}") from error
    except KeyboardInterrupt as error:
        raise InterruptedRunError(f"interrupted\n{how_to_go_on(directory)}") from error


def how_to_go_on(directory: Path) -> str:
    """Tell the user of an unfinished run what to do."""
    return f"What is done is kept in {directory}; the same command with --resume continues."


class Written(NamedTuple):
    """A run as it was saved, and its report."""

    saved: SavedRun
    report: Report


def write_files(run: EvaluationRun, directory: Path, video: int = 0) -> Written:
    """Derive every file of a run from its records; film the first ``video`` of each task."""
    summary = summarize(run, np.random.default_rng(run.header.seed))
    write_actions(run.records, directory)
    videos = [
        film(record.spec, record.trace.actions, directory / "videos" / film_name(record.spec.key))
        for record in run.records
        if record.spec.index < video
    ]
    saved = write_run(run, summary, directory)
    return Written(saved, write_report([saved], directory, videos))


def _report(run: EvaluationRun, directory: Path, video: int, *, as_json: bool) -> None:
    """Write every file, and print what a person or a program asked for."""
    written = write_files(run, directory, video)
    if as_json:
        print(to_text(dict(written.saved.document)), end="")
    else:
        show_report(written.report, data_console())
    notes.print(f"report: {directory / 'report.html'}", markup=False)
