"""Evaluate a policy on a suite: play its episodes, then derive every file of the run."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from minitouch_bench.conditions import STANDARD, Conditions
from minitouch_bench.documents import write_toml
from minitouch_bench.errors import (
    HopelessRunError,
    InfrastructureError,
    InterruptedRunError,
    UsageError,
)
from minitouch_bench.evaluation.actions import write_actions
from minitouch_bench.evaluation.actors import prepare_policies
from minitouch_bench.evaluation.engine import LOCAL, Engine, EngineOptions, open_engine
from minitouch_bench.evaluation.filming import film, film_name, require_video
from minitouch_bench.evaluation.run import OpenRun, RunRequest, open_run, run_episodes
from minitouch_bench.evaluation.suites import choose_episodes, choose_tasks, find_suite
from minitouch_bench.files import (
    MAX_EPISODES,
    REPORTS,
    SETTINGS_FILE,
    VIDEOS,
    holds_run,
    lock_directory,
    make_folder,
    write_file,
)
from minitouch_bench.metrics.summary import summarize
from minitouch_bench.policies.isolation.options import SANDBOXED, IsolationOptions
from minitouch_bench.records import EvaluationRun, SavedRun
from minitouch_bench.reporting.report import Report, build_report
from minitouch_bench.reporting.run_directory import save, write_report, write_run
from minitouch_bench.workflows import SILENT, Callbacks
from minitouch_bench.workflows.experiment_log import check_tracker, log_run


@dataclass(frozen=True)
class OutputOptions:
    """Where a run is kept, and what to do with a run that is there already.

    ``directory`` None: in ``REPORTS``. ``in_memory``: nothing is written, and an interrupted
    run is lost. ``video``: how many episodes of each task are filmed. ``settings``: the command's
    options, which are written beside the run. ``log``: the tracker that a finished run is sent to.
    """

    directory: Path | None = None
    in_memory: bool = False
    resume: bool = False
    fresh: bool = False
    video: int = 0
    settings: Mapping[str, Any] = field(default_factory=dict)
    log: str | None = None


@dataclass(frozen=True)
class EvaluateOptions:
    """What to evaluate, and how.

    ``tasks``, ``episodes`` (per task), ``seed``: None for the suite's own. ``episodes_from``:
    only these episodes, as in ("pushing/3,17", "opening/0"), in place of tasks and a number.
    ``policy``: a name, a file and so on as on the command line, or an object in memory.
    ``exploration``: the policy as of the end of the exploration phase. ``name``: what reports
    call the policy.
    """

    policy: object
    suite: str = "table4"
    tasks: tuple[str, ...] | None = None
    episodes: int | None = None
    seed: int | None = None
    episodes_from: tuple[str, ...] = ()
    exploration: object | None = None
    name: str | None = None
    engine: EngineOptions = LOCAL
    isolation: IsolationOptions = SANDBOXED
    conditions: Conditions = STANDARD
    output: OutputOptions = OutputOptions()


@dataclass(frozen=True)
class EvaluationResult:
    """A finished run: what was saved, its report, and its directory if it has one."""

    saved: SavedRun
    report: Report
    directory: Path | None = None


def evaluate(options: EvaluateOptions, callbacks: Callbacks = SILENT) -> EvaluationResult:
    """Run a policy through a suite, write every file of the run, and return it.

    Raises:
        UsageError: an option has no meaning.
        PolicyError, IsolationError, MissingExtraError: the policy cannot be used.
        RunDirectoryError: the directory is in use, or holds another run.
        InfrastructureError, HopelessRunError, InterruptedRunError: the run is incomplete and can
            be resumed.
    """
    output = options.output
    if output.in_memory and (output.resume or output.fresh or output.video or output.log):
        raise UsageError("resume, fresh, video and log need a directory: give an output")
    if output.log is not None:
        check_tracker(output.log)
    if output.video:
        require_video()
    opening = open_engine(options.engine, callbacks.note)
    request = make_request(options, callbacks)
    if output.in_memory:
        with opening as engine:
            run = play(request, OpenRun(request.header()), engine, callbacks)
        saved = save(run, summarize(run), run_name(request))
        return EvaluationResult(saved, build_report([saved]))
    directory = output.directory or REPORTS / run_name(request)
    with opening as engine, lock_directory(directory):
        if output.resume and not holds_run(directory):
            callbacks.note(f"there is no run in {directory} to resume: a new one begins")
        opened = open_run(request, directory, resume=output.resume, fresh=output.fresh)
        if output.settings:
            text = f"# minitouch-bench evaluate --config {SETTINGS_FILE}\n"
            write_file(directory / SETTINGS_FILE, text + write_toml(output.settings))
        run = play(request, opened, engine, callbacks)
        done = save_run(run, directory, output.video)
        if output.log is not None:
            log_run(output.log, done.saved, directory)
        return done


def make_request(options: EvaluateOptions, callbacks: Callbacks = SILENT) -> RunRequest:
    """Find suite, tasks and policies; each policy is loaded once.

    Raises:
        UsageError: an option has no meaning.
        PolicyError, IsolationError, MissingExtraError: a policy cannot be used.
    """
    suite = find_suite(options.suite)
    episodes = suite.episodes_per_task if options.episodes is None else options.episodes
    seed = suite.seed if options.seed is None else options.seed
    if not 1 <= episodes <= MAX_EPISODES or seed < 0:
        raise UsageError(f"episodes can be 1 to {MAX_EPISODES:,}, and a seed 0 or more")
    chosen = choose_episodes(options.episodes_from, suite)
    if chosen and (options.tasks is not None or options.episodes is not None):
        raise UsageError("--episodes-from names tasks and episodes: leave out --tasks, --episodes")
    tasks = choose_tasks([key.partition("/")[0] for key in chosen] or options.tasks, suite)
    setup = prepare_policies(
        options.policy,
        tasks,
        options.isolation,
        callbacks.note,
        exploration=options.exploration,
        name=options.name,
        conditions=options.conditions,
    )
    return RunRequest(suite, tasks, episodes, seed, setup, chosen)


def run_name(request: RunRequest) -> str:
    """Name a run after its policy, suite and conditions, in characters that suit a file name."""
    policy = _file_name(request.setup.policy.name)[:80] or "policy"
    conditions = [_file_name(words) for words in request.setup.conditions.in_words()]
    return "-".join((policy, request.suite.name, *conditions))


def _file_name(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "-", text).strip(".-")


def play(
    request: RunRequest, opened: OpenRun, engine: Engine, callbacks: Callbacks = SILENT
) -> EvaluationRun:
    """Run the episodes that are missing; tell the callbacks of those that are done, too."""
    if opened.torn:
        callbacks.note("the journal's last line was torn and has been cut off")
    callbacks.phase("episodes", len(request.specs()))
    for record in opened.records:
        callbacks.episode(record)
    with resumable(opened.directory):
        return run_episodes(request, opened, engine, callbacks.episode)


@contextmanager
def resumable(directory: Path | None) -> Iterator[None]:
    """Tell the user of an interrupted run how to continue it."""
    advice = (
        "Nothing is kept: a run with an output directory could be resumed."
        if directory is None
        else f"What is done is kept in {directory}; the same command with --resume continues."
    )
    try:
        yield
    except HopelessRunError as error:
        raise HopelessRunError(f"{error}\n{advice}") from error
    except InfrastructureError as error:
        raise InfrastructureError(f"{error}\n{advice}") from error
    except KeyboardInterrupt as error:
        raise InterruptedRunError(f"interrupted\n{advice}") from error


def save_run(run: EvaluationRun, directory: Path, video: int = 0) -> EvaluationResult:
    """Derive every file of a run from its records; film the first ``video`` of each task."""
    write_actions(run.records, directory)
    videos = [
        film(
            record.spec,
            record.trace.actions,
            make_folder(directory / VIDEOS) / film_name(record.spec.key),
            run.header.played_under,
        )
        for record in run.records
        if record.spec.index < video
    ]
    saved = write_run(run, summarize(run), directory)
    return EvaluationResult(saved, write_report([saved], directory, videos), directory)
