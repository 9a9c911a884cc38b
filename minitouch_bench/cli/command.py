"""Workflow functions as commands: a function's annotated parameters are the options."""

import inspect
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Annotated, Any, get_args, get_origin

from typer.models import ArgumentInfo, OptionInfo

from minitouch_bench.cli.console import EpisodeProgress, notes
from minitouch_bench.workflows import Callbacks
from minitouch_bench.workflows.options import OnCommandLine

CALLBACKS = "callbacks"


@contextmanager
def episode_progress() -> Iterator[Callbacks]:
    """Show a workflow's episodes while they are played."""
    with EpisodeProgress(notes) as progress:
        yield progress.callbacks


def as_command(
    workflow: Callable[..., Any],
    show: Callable[..., None],
    progress: Callable[[], AbstractContextManager[object]] = episode_progress,
) -> Callable[..., None]:
    """Return a function that Typer makes a command of.

    Its parameters are those of ``workflow`` and then those of ``show`` that say how they are given
    on the command line. ``show`` prints the result, which is its first argument, and raises
    ``typer.Exit`` where the command fails. It can ask for parameters of ``workflow`` by their name.
    ``progress`` gives the callbacks of ``workflow``, if it has some.
    """
    options = list(_options(workflow))
    shown = list(_options(show))
    shared = {option.name for option in options} & {*inspect.signature(show).parameters}
    has_callbacks = CALLBACKS in inspect.signature(workflow).parameters

    def run(**given: Any) -> None:
        for_show = {option.name: given.pop(option.name) for option in shown}
        for_show |= {name: given[name] for name in shared}
        if has_callbacks:
            with progress() as callbacks:
                result = workflow(**given, **{CALLBACKS: callbacks})
        else:
            result = workflow(**given)
        show(result, **for_show)

    parameters = [*options, *shown]
    run.__name__, run.__doc__ = workflow.__name__, _for_people(workflow)
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {option.name: option.annotation for option in parameters}
    return run


def _options(function: Callable[..., Any]) -> Iterator[inspect.Parameter]:
    """Yield the parameters that are given on the command line, as Typer reads them."""
    for parameter in inspect.signature(function).parameters.values():
        if get_origin(parameter.annotation) is not Annotated:
            continue
        for detail in get_args(parameter.annotation)[1:]:
            annotation, default = parameter.annotation, parameter.default
            if isinstance(detail, OnCommandLine):
                annotation = Annotated[detail.kind, detail.option]
                default = default if detail.default is ... else detail.default
            elif not isinstance(detail, ArgumentInfo | OptionInfo):
                continue
            yield inspect.Parameter(
                parameter.name,
                inspect.Parameter.KEYWORD_ONLY,
                annotation=annotation,
                default=default,
            )


def _for_people(workflow: Callable[..., Any]) -> str:
    """Return the first paragraph of a docstring, which is the help of a command."""
    return (inspect.getdoc(workflow) or "").partition("\n\n")[0]
