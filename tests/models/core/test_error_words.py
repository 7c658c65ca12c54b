"""Errors in the words of each front end."""

from __future__ import annotations

import pickle

import pytest

from models.core.errors import COMMAND_REMEDIES, NO_BALLS, OptionError, TableNotFound, TrackError, TruerollError
from pipeline.reporting.text.text_formatting import PAGE_REMEDIES, format_error


@pytest.mark.parametrize(
    ("error", "command", "page"),
    [
        (OptionError("lies within the shot; got 9", option="at"), "--at lies within", "The moment lies within"),
        (OptionError("is one of pot, carom", option="game"), "--game is one of pot", "The game is one of pot"),
        (TableNotFound("a.mp4 shows no cloth", remedy="corners"), "; give the corners of the playing surface with --c",
         "; film it with all four cushions in view, or mark its corners"),
        (TrackError(NO_BALLS, remedy="balls"), ", or give --corners and --ball-radius", ", or film the table from"),
        (OptionError("balls are small", remedy="radius"), "small; give --ball-radius in metres", "balls are small"),
        (TruerollError("nothing to name"), "nothing to name", "nothing to name"),
    ],
)  # fmt: skip
def test_an_error_names_options_to_who_has_them_alone(error: TruerollError, command: str, page: str) -> None:
    assert command in format_error(error)
    assert page in (shown := format_error(error, for_page=True))
    assert "--" not in shown
    assert str(pickle.loads(pickle.dumps(error))) == str(error), "it passes between processes"


def test_remedies_have_one_name_each() -> None:
    assert PAGE_REMEDIES.keys() <= COMMAND_REMEDIES.keys()
