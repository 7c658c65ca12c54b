"""MkDocs hooks: tables of the documentation that are derived from the source.

A page asks for a table by a comment on a line of its own:

    <!-- modules: models -->     every module below a package, with the first sentence of its docstring
    <!-- options: run -->        the arguments and options of a command
"""

from __future__ import annotations

import ast
import inspect
import re
import sys
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

MARKER = re.compile(r"^<!-- (modules|options): ([\w.-]+) -->$", re.MULTILINE)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace every marker of a page by its table."""
    return MARKER.sub(_format_table, markdown)


def _format_table(marker: re.Match[str]) -> str:
    kind, name = marker.groups()
    return _format_modules(name) if kind == "modules" else _format_options(name)


def _format_modules(package: str) -> str:
    """Format one table per folder that holds modules: module name and first sentence of its docstring."""
    root = ROOT / package.replace(".", "/")
    folders = sorted({path.parent for path in root.rglob("*.py") if path.name != "__init__.py"})
    return "\n\n".join(_format_folder(folder) for folder in folders)


def _format_folder(folder: Path) -> str:
    name = ".".join(folder.relative_to(ROOT).parts)
    paths = sorted(path for path in folder.glob("*.py") if path.name != "__init__.py")
    rows = [f"| `{path.stem}` | {_escape_cell(_first_sentence(path))} |" for path in paths]
    init = folder / "__init__.py"
    summary = f"{_first_sentence(init)}\n\n" if init.exists() else ""
    return f"### {name}\n\n{summary}| module | contents |\n|---|---|\n" + "\n".join(rows)


def _first_sentence(path: Path) -> str:
    """Return the first paragraph of a module's docstring on one line."""
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(docstring.partition("\n\n")[0].split())


def _format_options(name: str) -> str:
    """Format the arguments and options of one command as a table."""
    import typer.main

    from pipeline.cli.commands import load_command
    from pipeline.terminal.command_line import app

    load_command(name)
    callback = next(command.callback for command in app.registered_commands if command.name == name)
    kinds = {key: _find_kind(entry) for key, entry in inspect.signature(callback, eval_str=True).parameters.items()}
    group = typer.main.get_command(app)
    command = getattr(group, "commands", {}).get(name, group)
    rows = [
        _format_parameter(parameter, kinds[parameter.name]) for parameter in command.params if parameter.name in kinds
    ]
    return "| argument or option | value | meaning |\n|---|---|---|\n" + "\n".join(rows)


def _find_kind(parameter: inspect.Parameter) -> Any:
    kind = parameter.annotation
    return get_args(kind)[0] if get_origin(kind) is Annotated else kind


def _format_parameter(parameter: Any, kind: Any) -> str:
    is_argument = parameter.param_type_name == "argument"
    names = (parameter.metavar or parameter.name,) if is_argument else parameter.opts
    shown = ", ".join(f"`{_escape_pipes(name)}`" for name in names)
    value = "" if is_argument or kind is bool else _escape_cell(parameter.metavar or _format_kind(kind))
    meaning = _escape_cell(" ".join((parameter.help or "").split()))
    has_default = kind is not bool and isinstance(parameter.default, str | int | float) and parameter.default != ""
    return f"| {shown} | {value} | {meaning}{f' Default: `{parameter.default}`.' if has_default else ''} |"


def _format_kind(kind: Any) -> str:
    """Name what an option takes: its choices, or text, number, whole number, path."""
    if get_origin(kind) is Literal:
        return " or ".join(f"`{choice}`" for choice in get_args(kind))
    accepted = [part for part in get_args(kind) or (kind,) if part is not type(None)]
    names = {str: "text", int: "whole number", float: "number", Path: "path"}
    return " or ".join(names.get(part, getattr(part, "__name__", str(part))) for part in accepted)


def _escape_cell(text: str) -> str:
    return _escape_pipes(text).replace("<", "&lt;")


def _escape_pipes(text: str) -> str:
    return text.replace("|", "\\|")
