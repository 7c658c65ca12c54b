"""Options describe their range, accept only finite values within it, and are hashed by name and value."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import pytest

from models.core.options import OptionSpec, list_option_specs, option


@dataclass(frozen=True, slots=True)
class WaitOptions:
    """Options of a test."""

    patience: float = option(0.4, help="Longest wait.", unit="s", above=0)
    name: str = option("", help="A name.")


@pytest.mark.parametrize(
    ("spec", "words", "valid", "invalid"),
    [
        (OptionSpec("", "s", above=0), "more than 0 s", (1e-300, 5), (0, -1)),
        (OptionSpec("", "times", minimum=1, maximum=100), "1 to 100 times", (1, 100), (0.99, 101)),
        (OptionSpec("", "m/s", above=0, maximum=1), "more than 0 and at most 1 m/s", (0.5, 1), (0, 1.5)),
        (OptionSpec("", minimum=0), "0 or more", (0, 3), (-1,)),
        (OptionSpec("", maximum=4), "at most 4", (4, -9), (5,)),
        (OptionSpec("", "m"), "", (-1, 0), ()),
    ],
)
def test_a_range_is_described_and_checked(
    spec: OptionSpec, words: str, valid: tuple[float, ...], invalid: tuple[float, ...]
) -> None:
    assert spec.valid_range == words
    assert all(spec.allows(value) for value in valid)
    assert not any(spec.allows(value) for value in (*invalid, math.nan, math.inf, -math.inf))


def test_options_are_plain_values_with_their_specifications() -> None:
    assert asdict(WaitOptions(patience=1.0)) == {"patience": 1.0, "name": ""}
    assert {name: spec.unit for name, spec in list_option_specs(WaitOptions).items()} == {"patience": "s", "name": ""}
