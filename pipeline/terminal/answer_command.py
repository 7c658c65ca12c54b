"""Commands that are functions of Python: one definition of their options, and one way to print their answers."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from inspect import BoundArguments, Parameter, Signature, cleandoc, signature
from os import PathLike
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, ParamSpec, Union, get_args, get_origin

import typer

from models.core.answer import Answer
from pipeline.terminal import command_line as cli

if TYPE_CHECKING:
    from models.estimation.table_learning.learned_table import LearnedTable

P = ParamSpec("P")


def ignore(news: object) -> None:
    """Show nothing of what a function does."""


def answer_command(name: str, **settings: Any) -> Callable[[Callable[P, Answer]], Callable[P, Answer]]:
    """Make a command of a public function of Python: one definition of its options, and its answer is printed.

    A parameter that is annotated for typer becomes an argument or option; `on_activity` is called with what is done,
    `on_answer` with each of several answers.

    Args:
        name: Name of the command.
        settings: Further settings of the command, as typer takes them.

    Returns:
        A decorator that returns the function as it is.
    """

    def decorate(function: Callable[P, Answer]) -> Callable[P, Answer]:
        whole = signature(function, eval_str=True)
        own = [one for one in whole.parameters.values() if one.name not in ("on_activity", "on_answer")]

        def command(*, as_json: bool, **values: Any) -> None:
            def show_answer(answer: Answer) -> None:
                cli.print_answer(answer, as_json)

            with _show_activity("on_activity" in whole.parameters) as on_activity:
                given = BoundArguments(whole, OrderedDict(values, on_activity=on_activity, on_answer=show_answer))
                answer = function(*given.args, **given.kwargs)
            if "on_answer" not in whole.parameters:
                show_answer(answer)
            if answer.refusals:
                raise typer.Exit(1)

        as_json = Parameter("as_json", Parameter.KEYWORD_ONLY, default=False, annotation=cli.JsonOption)
        command.__signature__ = Signature([*map(_reduce_parameter, own), as_json])  # type: ignore[attr-defined]
        command.__doc__ = function.__doc__
        cli.command(name, **settings)(command)
        stated = {one.name: cli.split_annotation(one) for one in own}
        common = "\n".join(f"    {key}: {option.help}" for key, (_, option) in stated.items() if option.help)
        function.__doc__ = f"{cleandoc(function.__doc__ or '')}\n{common}"
        function.__signature__ = whole.replace(  # type: ignore[attr-defined]
            parameters=[
                one.replace(annotation=stated.get(key, (one.annotation,))[0]) for key, one in whole.parameters.items()
            ]
        )
        return function

    return decorate


def _show_activity(is_shown: bool) -> AbstractContextManager[Callable[[str], None]]:
    """Show activities on the console if the command has any."""
    if not is_shown:
        return nullcontext(ignore)
    from pipeline.terminal.progress_display import show_activity  # numba is slow to import

    return show_activity(cli.console)


def _reduce_parameter(one: Parameter) -> Parameter:
    """Reduce the types of a parameter of Python to the one that typer makes of words."""
    kind, stated = cli.split_annotation(one)
    plain = _reduce_type(kind)
    kind = list[plain] if one.kind is Parameter.VAR_POSITIONAL else plain  # type: ignore[valid-type]
    return one.replace(kind=Parameter.KEYWORD_ONLY, annotation=Annotated[kind, stated])


def _reduce_type(kind: Any) -> Any:
    """Reduce the types that a function takes to the one that typer makes of words, and None."""
    options = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    origins = [get_origin(one) or one for one in options]
    if Sequence in origins:
        plain: Any = list[_reduce_type(get_args(options[origins.index(Sequence)])[0])]  # type: ignore[misc]
    elif PathLike in origins:
        plain = Path
    elif str in origins or Literal in origins:
        plain = str
    else:
        return kind
    return plain | None if type(None) in options else plain


def read_learned_table(profile: cli.AnyPath | None) -> LearnedTable | None:
    """Read what other shots taught about a table; None without a profile."""
    if profile is None:
        return None
    from pipeline.io.table_profile import parse_learned_table, read_profile_text  # slow to import

    return parse_learned_table(read_profile_text(Path(profile)))
