"""The sentences of a diagnosis say what its numbers say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from diagnosis.close import Ahead, Closing
from diagnosis.verdict import Candidate, EffectShare, Gap, Place, Report, Strength
from models.gap_scene import Recording
from pipeline.gap_page import _plots, write_gap_page
from pipeline.gap_words import causes, gap_sentence, strengths

NOTHING = Closing(0.02, 0.02, 0.01, float("nan"), (-1.0, 1.0), False)


def report(verdict: str, *where: Place) -> Report:
    unknown = Candidate("unknown", 1.0, ("unknown",), ())
    return Report(
        "billiards", (), verdict, (), (unknown,), where, "along the motion everywhere (21 sigma)",  # type: ignore[arg-type]
        Gap("rms_m", 0.85, (), NOTHING, (), (), ()), (), (), ("mirror", "inelastic"), (), (), "", 1e-9, (),
    )  # fmt: skip


def at(phase: str, share: float, grows: str | None = None) -> Place:
    return Place(phase, share, None, None, None, None, grows)


def test_what_is_unknown_is_told_by_where_most_of_it_shows_not_in_sigmas() -> None:
    said = gap_sentence(report("unknown", at("cushion_contact", 0.86), at("rest", 0.14)))
    assert "86%" in said
    assert "cushion contact" in said
    assert "sigma" not in said
    assert "growing with time" in gap_sentence(report("unknown", at("free_roll", 1.0, "time")))
    assert gap_sentence(report("unknown")).endswith("does not hold.")


def test_the_page_says_what_each_of_several_effects_closes(tmp_path: Path) -> None:
    shares = (EffectShare("air_drag", -0.02, (-0.04, 0.35)), EffectShare("cushion_law", 0.96, (0.66, 0.98)))
    told = replace(report("effects"), effects=("air_drag", "cushion_law"), per_effect=shares)
    write_gap_page(told, "carom", tmp_path / "gap.html")
    page = (tmp_path / "gap.html").read_text(encoding="utf-8")
    assert "How much of the gap each one closes" in page
    assert "<td>96 %</td><td>66 to 98 %</td>" in page
    write_gap_page(replace(told, per_effect=shares[:1]), "carom", tmp_path / "gap.html")
    assert "each one closes" not in (tmp_path / "gap.html").read_text(encoding="utf-8")


def test_predictions_after_are_drawn_only_where_something_was_added() -> None:
    t = np.arange(20) / 30
    places = np.stack([t, t], axis=-1)[:, None]
    window = Ahead(Recording(0, np.arange(20), t, ("a",), places, np.full((20, 1), 1e-3)), 8)
    alone = Gap("rms_m", 0.4, (0,), NOTHING, (window,), (places + 0.01,), (places + 0.01,))
    titles = [title for title, _ in _plots(alone)]
    assert not any("before and after" in title for title in titles)
    better = replace(alone, after=(places + 0.001,))
    assert any("before and after" in title for title, _ in _plots(better))


def test_errors_are_drawn_only_where_something_could_be_foreseen() -> None:
    t = np.arange(20) / 30
    places = np.stack([t, t], axis=-1)[:, None]
    piece = Recording(0, np.arange(20), t, ("a",), places, np.full((20, 1), 1e-3))
    for known, drawn in ((8, 3), (20, 1)):
        assert len(_plots(Gap("rms_m", 0.4, (0,), NOTHING, (Ahead(piece, known),), (places,), (places,)))) == drawn


def test_effects_that_are_missing_together_are_one_cause_of_their_whole_probability() -> None:
    drag, lift = (Strength(name, "1", 0.2, 0.01, 0.05) for name in ("k", "s"))
    alike = (Candidate("air_drag", 0.46, ("air_drag",), (drag,)), Candidate("magnus", 0.44, ("magnus",), (lift,)))
    told = replace(report("effects"), effects=("air_drag", "magnus"))
    told = replace(told, candidates=(*alike, Candidate("unknown", 0.1, ("unknown",), ())))
    together, unknown = causes(told)
    assert (together.effect, unknown.effect) == ("air_drag and magnus", "unknown")
    assert together.probability == pytest.approx(0.9)
    assert strengths(together) == "air drag k = 0.2 ± 0.01; magnus s = 0.2 ± 0.01"
    assert causes(replace(told, effects=("air_drag",))) == told.candidates
