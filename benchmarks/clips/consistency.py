"""Compare what the outputs of run folders state, and list the statements that contradict each other: the goal is 0.

    python -m benchmarks.clips.consistency DIR... [--commands call,put-back,compare,predict,what-if,certify]

Every output becomes rows of text in which names are replaced by ids: the report, what `run` printed (DIR.log, if it is
there), and sentences, tables, JSON and image texts of the commands. A statement is a quantity of named things with an
interval: 0.54 s lies between 0.535 and 0.545 s. Two statements on the same thing contradict each other if their words
differ or their intervals do not meet. Prints one row per folder, the contradictions, and what was compared with
nothing: a command that refuses, and one in whose outputs no statement was found that any other output makes too.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import json
import math
import re
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from html.parser import HTMLParser
from itertools import combinations
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import trueroll
from models.core.answer import Answer
from models.core.errors import TruerollError
from models.core.naming import Naming
from models.core.scene import CUSHIONS, POCKETS, Table
from models.estimation.ball_places import measure_cushion_distances
from pipeline.actions.play_otherwise import MIN_PROBABILITY
from pipeline.io.certificate_files import NAMES
from pipeline.io.run_folder import list_folders_with
from pipeline.io.run_views import read_shot_record
from pipeline.reporting.pages.certificate_page import FALLS
from pipeline.reporting.text.number_sentences import NUMBER_NAMES, name_number
from pipeline.terminal import command_line
from video.overlay.close_up import draw_close_up

COMMANDS = ("call", "put-back", "compare", "predict", "what-if", "certify")
UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "ms": 1e-3, "s": 1.0, "m/s": 1.0, "km/h": 1 / 3.6, "%": 1e-2, "°": 1.0,
         "rad/s": 1.0, "": 1.0}  # fmt: skip
# Of what `above 99.9 %` means, from the number.
BOUNDS = {"above ": (0.0, 100.0), "below ": (-100.0, 0.0)}
NUMBER = r"(?:above |below )?-?\d+(?:\.\d+)?"
UNIT = r"(?:mm|cm|ms|m/s|m|s|km/h|%|°|rad/s)(?![\w/])"
SIGNS = {"right": 1, "left": -1, "top": 1, "back": -1}
# Clauses on an event, by its kind; names are ids in «».
EVENT_VERBS = {
    "strike": r"«(?P<a>[^»]+)» (?:is|was) struck",
    "ball": r"«(?P<a>[^»]+)» (?:and «(?P<b>[^»]+)» touch|touch(?:es|ed) «(?P<c>[^»]+)»|hit «(?P<d>[^»]+)» first)",
    "cushion": r"«(?P<a>[^»]+)» hits «(?P<b>[^»]+)»",
    "pocket": r"«(?P<a>[^»]+)» (?:(?:falls|fell) )?into the «(?P<b>[^»]+)»",
    "rest": r"«(?P<a>[^»]+)» (?:comes|came) to rest",
}
# Values that a row with one event states of it.
ROW_VALUES = {
    "time": rf"(?<!± )({NUMBER} s)(?: ±|,| \(|\b)", "time sigma": rf"\d s ± ({NUMBER} m?s)",
    "speed": rf"at ({NUMBER} m/s)", "speed in km/h": rf"\(({NUMBER} km/h)\)",
    "probability": rf"({NUMBER} %)(?! of the ball)",
    "gap": rf"({NUMBER}(?: ± {NUMBER})? mm) from a (?:miss|touch)", "frame": rf"(?<!around )frame ({NUMBER})",
}  # fmt: skip
PLACE = rf"({NUMBER} cm)(?: \([^)]*\))? from «(\w+)»"
CLOSE_UP = "pipeline.actions.answer_call.draw_close_up"
# Numbers of a certificate in its sentence, with their standard deviations.
CERTIFICATE_CLAUSES = {
    "restitution": rf"its cushions return ({NUMBER}) ± ({NUMBER}) of the speed",
    "roll_out": rf"a ball of 2 m/s rolls ({NUMBER}) ± ({NUMBER}) m",
}


@dataclass(frozen=True)
class Statement:
    """What one output states of one quantity."""

    key: tuple[str, ...]
    """The quantity, then what it is about."""
    words: str
    """As it is written; compared where there is no number."""
    source: str
    low: float = math.nan
    high: float = math.nan
    """Bounds of what rounds to the written number, in the units of the table."""
    unit: str = ""
    side: str = ""
    decimals: int | None = None
    """None for the number of a file, which is not rounded for readers."""

    def find_difference(self, other: Statement) -> str:
        """Name in what two statements on the same thing differ; empty where they agree."""
        if math.isnan(self.low) or math.isnan(other.low):
            return "words" if self.words != other.words else ""
        slack = 1e-6 * max(abs(self.high), abs(other.high))
        if self.low > other.high + slack or other.low > self.high + slack:
            return "number"
        if None in (self.decimals, other.decimals):
            return ""
        if self.side != other.side:
            return "side"
        return "rounding" if self.unit == other.unit and self.decimals != other.decimals else ""


def state(key: tuple[str, ...], value: Any, source: str) -> Statement:
    """Make a statement of a number with its unit as text, of a number of a file, or of a word."""
    if isinstance(value, float | int):
        return Statement(key, f"{value}", source, float(value), float(value))
    if value == "may be zero":
        return Statement(key, value, source, -math.inf, math.inf)
    if counts := re.fullmatch(r"(\d+) or (\d+)", value):
        return Statement(key, value, source, float(counts[1]), float(counts[2]))
    form = rf"({'|'.join(BOUNDS)}|)(-?\d+(?:\.(\d+))?)(?: ± [\d.]+)? ?((?!top|back|right|left|either)[a-z/]+|%|°|)"
    form += rf"(?: \([^)]*\))?(?: ?({'|'.join(SIGNS)}|either way))?"
    parts = re.fullmatch(form, re.sub(r"may be zero \((.*)\)", r"\1 either way", value))
    if parts is None or parts[4] not in UNITS:
        return Statement(key, value.lower().removeprefix("the "), source)
    limit, number, decimals, unit, side = (one or "" for one in parts.groups())
    zeros = len(number) - len(number.rstrip("0")) if not decimals and number.strip("-0") else 0
    half = 0.5 * 10.0 ** (zeros - len(decimals))  # 90 cm may be 92.6 cm with an error of 20 cm
    low, high = BOUNDS.get(limit, (-half, half))
    scale = UNITS[unit] * SIGNS.get(side, 1)
    ends = sorted((scale * (float(number) + low), scale * (float(number) + high)))
    if side == "either way":
        ends = [-max(map(abs, ends)), max(map(abs, ends))]
    return Statement(key, value, source, ends[0], ends[1], unit, side, len(decimals))


def read_direction(shown: str) -> str:
    """Turn an angle to rails, towards two of them, into one from the x axis towards `bottom`; else leave the text."""
    form = rf"({NUMBER})(?: ± [\d.]+)?° to the (long|short) \w+, towards «(\w+)» and «(\w+)»"
    if (found := re.fullmatch(form, shown)) is None:
        return shown
    angle = float(found[1]) if found[2] == "long" else 90 - float(found[1])
    angle = 180 - angle if "left" in found.groups() else angle
    return f"{-angle if 'top' in found.groups() else angle:.{len(found[1].partition('.')[2])}f}°"


class PageRows(HTMLParser):
    """Rows of text of a page: cells and inline texts are separated by bars, blocks by line ends."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.parts: list[str] = []
        self.hidden = 0
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.hidden += tag in ("script", "style")
        self.parts.append("\n" if tag in ("tr", "p", "li", "h2", "h3", "div", "dt", "button") else " | ")

    def handle_endtag(self, tag: str) -> None:
        self.hidden -= tag in ("script", "style")
        self.parts.append(" ")

    def handle_data(self, data: str) -> None:
        self.parts.append("" if self.hidden else data)

    def rows(self) -> list[str]:
        return [" ".join(row.split()) for row in "".join(self.parts).split("\n") if row.strip(" |")]


@dataclass(frozen=True)
class RunStatements:
    """Collects the statements of one run folder."""

    folder: Path
    naming: Naming
    events: list[dict[str, str]]
    unexplained: tuple[str, ...] = ()
    """Balls that moved without an event: what set them in motion is not known."""

    @property
    def bodies_that_moved(self) -> set[str]:
        """Balls that lay in several places, and all else that events name."""
        return {*self.unexplained, *(body for one in self.events for body in (one["a"], one["b"]))}

    def identify(self, text: str) -> str:
        """Replace the names of balls, rails and pockets by their ids in «»; a name that is unknown stays."""
        names = {}
        for body in (*self.naming.looks, *CUSHIONS, *POCKETS):
            shown = self.naming.name_pocket(body) if body in POCKETS and body not in CUSHIONS else self.naming.say(body)
            names[shown.lower()] = names[shown.removeprefix("the ").lower()] = body
        names |= {self.naming.name_pocket(one).lower(): one for one in POCKETS}
        pattern = "|".join(re.escape(name) for name in sorted(names, key=len, reverse=True))
        return re.sub(rf"(?<![\w-])(?:{pattern})(?![\w-])", lambda found: f"«{names[found[0].lower()]}»", text,
                      flags=re.IGNORECASE)  # fmt: skip

    def find_event(self, kind: str, a: str, b: str, t: float) -> str:
        """Name the event of the run that a clause is about: the nearest in time of the same kind and bodies."""
        same = [k for k, one in enumerate(self.events) if one["kind"] == kind and {one["a"], one["b"]} == {a, b}]
        nearest = min(same, key=lambda k: abs(float(self.events[k]["t"]) - t), default=None)
        return f"{kind} {' '.join(sorted(filter(None, (a, b))))} " + ("?" if nearest is None else f"{nearest}")

    def read_events(self) -> Iterator[Statement]:
        """Read the statements of events.csv."""
        yield state(("any event",), "some" if self.events else "none", "events.csv")
        for k, one in enumerate(self.events):
            key = f"{one['kind']} {' '.join(sorted(filter(None, (one['a'], one['b']))))} {k}"
            yield state(("event", key), "there", "events.csv")
            names = {"time": "t", "time sigma": "t_sigma", "speed": "speed", "speed in km/h": "speed",
                     "probability": "probability", "frame": "frame"}  # fmt: skip
            for name, column in names.items():
                if one[column]:
                    value, half = float(one[column]), 0.5 * 10.0 ** -len(one[column].partition(".")[2])
                    yield Statement((name, key), one[column], "events.csv", value - half, value + half)
            if one["kind"] == "strike" and one["speed"] and sum(two["kind"] == "strike" for two in self.events) == 1:
                yield state(("number", NUMBER_NAMES["cue_speed"], one["a"]), float(one["speed"]), "events.csv")
            if one["gap_mm"]:
                yield state(("gap", key), abs(float(one["gap_mm"])) / 1000, "events.csv")

    def read_rows(self, rows: Iterable[str], source: str) -> Iterator[Statement]:
        """Read what rows of text state of events, places, numbers and calls."""
        for text in self.split_sentences(rows):
            if "No ball moves in this clip" in text:
                yield state(("any event",), "none", source)
            if shot := re.match(r"Shot: «([^»]+)» at", text):
                yield from self.read_shot_line(text, shot[1], source)
                continue
            clauses = [(kind, one) for kind, verb in EVENT_VERBS.items() for one in re.finditer(verb, text)]
            values = {name: re.findall(pattern, text) for name, pattern in ROW_VALUES.items()}
            if len(clauses) == 1 and values["time"]:
                kind, found = clauses[0]
                body = next((found[g] for g in ("b", "c", "d") if g in found.re.groupindex and found[g]), "")
                t = float(values["time"][0].split()[0])
                kind = "cushion" if kind == "ball" and body in CUSHIONS else kind
                key = self.find_event(kind, found["a"], body, t)
                yield state(("event", key), "there", source)
                for name, all_found in values.items():
                    if name == "probability" and "» first" in text:  # of this ball, at whatever moment
                        yield from (state(("first probability", found["a"]), one, source) for one in all_found[:1])
                    elif len(all_found) == 1:
                        yield state((name, key), all_found[0], source)
            cells = [one.strip() for one in text.split("|") if one.strip()]
            if len(cells) == 3 and cells[0] in NUMBER_NAMES.values() and cells[2] != "not measurable":
                yield state(("number", cells[0], cells[1].strip("«»")), read_direction(cells[2]), source)
            yield from self.read_story(text, source)

    def read_shot_line(self, text: str, ball: str, source: str) -> Iterator[Statement]:
        """Read the line of the main numbers of a shot."""
        first = re.search(r"«([^»]+)» first", text)
        if first:
            yield state(("first", ball), first[1], source)
        labels = {"cue_speed": ("", ball), "top_spin_share": ("spin ", ball), "side_spin_share": ("side ", ball),
                  "cut_angle": ("cut ", first and first[1])}  # fmt: skip
        for name, (label, subject) in labels.items():
            shown = re.search(rf", {label}(\d[^,]*)", text)
            if shown and subject:
                yield state(("number", NUMBER_NAMES[name], subject), shown[1], source)

    def split_sentences(self, rows: Iterable[str]) -> Iterator[str]:
        """Split rows into sentences, in which `it` is replaced by the last ball that began one."""
        subject = ""
        for row in map(self.identify, rows):
            for text in re.split(r"(?<=[^\d])\. (?=[A-Z«])", row):
                subject = found[0] if (found := re.search(r"^«[^»]+»|«[^»]+»(?=: )", text)) else subject
                text = re.sub(r"\b[Ii]t (was struck|touched|fell|came)", rf"{subject} \1", text)
                # the time of a score is that of its second ball, its probability that of all its contacts
                text, scores = re.subn(r"touched «[^»]+» and, after [^,]* in all, («[^»]+» at)", r"touched \1", text)
                yield re.sub(rf"{NUMBER} %", "", text) if scores else text

    def read_story(self, text: str, source: str) -> Iterator[Statement]:
        """Read what a sentence states of first contacts, places and rests."""
        for found in re.finditer(r"«([^»]+)» (?:hit|touched) «([^»]+)» first", text):
            yield state(("first", found[1]), found[2], source)
        for verb, name in (("arrived", "contact_speed"), ("left", "object_speed")):
            for found in re.finditer(rf"«([^»]+)» {verb} at ([^;]+ m/s \([^)]*\))", text):
                yield state(("number", NUMBER_NAMES[name], found[1]), found[2], source)
        if then := re.match(r"(?:Then )«([^»]+)» touched «", text):
            for later in re.finditer(rf"«([^»]+)» at ({NUMBER} s)", text):
                kind = "cushion" if later[1] in CUSHIONS else "ball"
                event = self.find_event(kind, then[1], later[1], float(later[2].split()[0]))
                yield from (state(("event", event), "there", source), state(("time", event), later[2], source))

    def read_numbers(self, numbers: list[dict[str, Any]], source: str) -> Iterator[Statement]:
        """Read the numbers of a shot from JSON."""
        for one in numbers:
            if one.get("observable", True) and not one["place"] and one["value"] is not None:
                value = float(one["value"]) * UNITS.get(one["unit"], 1)
                yield state(("number", NUMBER_NAMES[one["name"]], one["ball"]), value, source)
            if not one["place"]:
                is_measurable = "yes" if one.get("observable", True) else "no"
                yield state(("measurable", NUMBER_NAMES[one["name"]], one["ball"]), is_measurable, source)

    def read_calls(self, document: dict[str, Any], printed: str, figure: list[str]) -> Iterator[Statement]:
        """Read a call from its JSON, its terminal and its image."""
        about = document["asked"]
        printed, _, _ = printed.partition("; again at ")  # later touches of the same balls
        verdict = re.match(rf"(.+?) \((?:.+?: )?({NUMBER} %)\): (.*)", printed)
        if verdict is None:
            yield state(("form", about), printed, "terminal of call")
            return
        head = re.match(rf"(.+?)  \((?:.+?: )?({NUMBER} %)\)", figure[0]) if figure else None
        for source, found in (("terminal of call", verdict), ("image of call", head)):
            if found:
                yield state(("verdict", about), found[1], source)
                yield state(("probability", about), found[2], source)
        rows = {"terminal of call": [printed], "image of call": figure[1:]}
        if figure:
            yield state(("question", about), figure[1], "image of call")
        yield state(("question", about), about, "JSON of call")
        yield state(("verdict", about), document["verdict"], "JSON of call")
        yield state(("probability", about), document["probability"], "JSON of call")
        for name, key, pattern in (("time", "t", rf"({NUMBER} s) ±"), ("time sigma", "t_sigma", rf"s ± ({NUMBER} m?s)"),
                                   ("frame", "frame", rf"(?<!around )frame ({NUMBER})"),
                                   ("margin", "margin_mm", rf"({NUMBER}(?: ± {NUMBER})? mm)")):  # fmt: skip
            shown = [(where, one) for where, texts in rows.items() for one in re.findall(pattern, " | ".join(texts))]
            yield from (state((name, about), one, where) for where, one in shown)
            if document[key] is not None and shown:
                yield state((name, about), abs(document[key]) * (1e-3 if name == "margin" else 1), "JSON of call")
        kind, *_ = document["question"].split()
        if kind == "contact" and document["code"] == "yes":
            yield from self.read_rows([re.sub(r"\([^)]*%\)", "", printed)], "terminal of call")  # of any touch

    def read_places(self, document: dict[str, Any], rows: list[list[str]]) -> Iterator[Statement]:
        """Read the places of put-back from its JSON and from the table of its terminal."""
        rails = {self.naming.view.name_rail(one): one for one in CUSHIONS}
        moved = self.bodies_that_moved
        for ball in document["balls"]:
            for rail in CUSHIONS:
                key = ("distance", ball["id"], rail, "at the start" if ball["id"] in moved else "always")
                yield state(key, ball[f"{rail}_mm"] / 1000, "JSON of put-back")
        for cells in rows[1:]:
            ball_id = self.identify(cells[0]).strip("«»")
            moment = "at the start" if ball_id in moved else "always"
            for heading, cell in zip(rows[0], cells, strict=True):
                if heading in rails:
                    yield state(("distance", ball_id, rails[heading], moment), f"{cell} mm", "terminal of put-back")

    def read_session(self, document: dict[str, Any], rows: list[list[str]], numbers: list[Any]) -> Iterator[Statement]:
        """Read the numbers of compare, which are those of one shot, from its JSON and its terminal."""
        cue = numbers[0]["ball"] if numbers else ""
        of_cue_last = sorted(numbers, key=lambda one: one["ball"] == cue)  # compare has those of the cue ball
        keys = {name_number(one["name"]): ("number", NUMBER_NAMES[one["name"]], one["ball"]) for one in of_cue_last}
        for one in document["groups"]["all"]:
            if one["median"] is not None and name_number(one["name"]) in keys:
                yield state(
                    keys[name_number(one["name"])], one["median"] * UNITS.get(one["unit"], 1), "JSON of compare"
                )
        for cells in rows:
            if cells[0] in keys and len(cells) > 4:
                yield state(keys[cells[0]], read_direction(self.identify(cells[2])), "terminal of compare")

    def read_session_page(self, rows: list[str], table: list[dict[str, str]], shots: list[Any]) -> Iterator[Statement]:
        """Read the shots on the page of compare, with their names, its CSV, and what scene.json has of them."""
        cells = [[cell.strip() for cell in row.strip("| ").split("|")] for row in rows]
        headings = next((one for one in cells if "first ball" in one), [])
        listed = [one for one in cells if headings and len(one) == len(headings) and one is not headings]
        for k, shot in enumerate(shots):
            potted = "; ".join(f"«{one['ball']}» «{one['pocket']}»" for one in shot["potted"])
            yield state(("first of shot", f"{k}"), f"«{shot['first']}»" if shot["first"] else "", "scene.json")
            yield state(("potted in shot", f"{k}"), potted, "scene.json")
        for k, (row, one) in enumerate(zip(listed, table, strict=True)):
            shown = dict(zip(headings, row, strict=True))
            for name, heading, column in (("first of shot", "first ball", "first_name"),
                                          ("potted in shot", "potted", "potted_names"),
                                          ("spin in shot", "spin there", "spin_name")):  # fmt: skip
                yield state((name, f"{k}"), self.identify(shown[heading]), "page of compare")
                yield state((name, f"{k}"), self.identify(one[column]), "CSV of compare")
            if len(shots) == 1:
                of_cue_last = sorted(shots[0]["numbers"], key=lambda one: one["ball"] == shots[0]["cue"])
                for name, number in {one["name"]: one for one in of_cue_last}.items():
                    if value := shown.get(name_number(name)):
                        key = ("number", NUMBER_NAMES[name], number["ball"])
                        yield state(key, read_direction(self.identify(value)), "page of compare")

    def read_predictions(self, document: dict[str, Any], sentences: Iterable[str], table: Table) -> Iterator[Statement]:
        """Read motions, rests and places of predict from its JSON and its sentences."""
        moved = self.bodies_that_moved
        rests = {one["a"]: one["t"] for one in document["events"] if one["kind"] == "rest" and one["probability"] > 0.5}
        last = {body: one["kind"] for one in self.events for body in (one["a"], one["b"])}
        yield state(("end of the observations",), document["t"], "JSON of predict")
        for ball, text in zip(document["balls"], map(self.identify, sentences), strict=True):
            name = re.match(r"«([^»]+)»", text)
            yield state(("ball of a sentence", ball["id"]), name[1] if name else text, "terminal of predict")
            yield state(("ball of a sentence", ball["id"]), ball["id"], "JSON of predict")
            verb = re.search(r"stays at rest|is at rest|keeps moving", text)
            if verb:
                motion = "moves" if verb[0] == "keeps moving" else "rests"
                yield state(("motion at the end", ball["id"]), motion, "terminal of predict")
            if last.get(ball["id"], "rest") == "rest":
                yield state(("motion at the end", ball["id"]), "rests", "events.csv")
            if shown := re.search(rf"comes to rest at ({NUMBER} s)", text):
                yield state(("predicted rest", ball["id"]), shown[1], "terminal of predict")
                yield state(("predicted rest", ball["id"]), rests.get(ball["id"], "none"), "JSON of predict")
            if ball["end"]:
                place = measure_cushion_distances(table, np.array([[ball["end"]["x"], ball["end"]["y"]]]))[0]
                for rail, distance in zip(CUSHIONS, place, strict=True):
                    yield state(("distance", ball["id"], rail, "predicted"), float(distance), "JSON of predict")
            for distance, rail in re.findall(PLACE, text):
                yield state(("distance", ball["id"], rail, "predicted"), distance, "terminal of predict")
                if ball["id"] not in moved and "stays at rest" in text:  # another one may be touched later
                    yield state(("distance", ball["id"], rail, "always"), distance, "terminal of predict")

    def read_what_if(self, document: dict[str, Any], sentences: Iterable[str], is_single: bool) -> Iterator[Statement]:
        """Read what a what-if states of the real stroke, of its plays, and of a shot in which nothing is changed."""
        cue, source = document["cue"], "terminal of what-if"
        raw = " ".join(sentences)
        text = self.identify(raw)
        is_real = "Nothing is changed" in text
        named = {"cue_speed": rf"instead of ({NUMBER} m/s \([^)]*\))",
                 "top_spin_share": rf"instead of ({NUMBER} (?:top|back)) ",
                 "side_spin_share": rf"instead of ({NUMBER} (?:left|right)) side"}  # fmt: skip
        for name, pattern in named.items():
            if is_single and (found := re.search(pattern, text)):
                yield state(("number", NUMBER_NAMES[name], cue), found[1], source)
                is_doubtful = text[found.end() :].startswith(", where it is not measurable")
                yield state(("measurable", NUMBER_NAMES[name], cue), "no" if is_doubtful else "yes", source)
        for name, side in (("top_spin_share", "top|back"), ("side_spin_share", "(?:left|right) side")):
            if is_single and re.search(rf"(?:{side}) spin[^;]*, where it is not measurable", text):
                yield state(("measurable", NUMBER_NAMES[name], cue), "no", source)
        form = rf"[^.:]*?with a probability (?:of )?({NUMBER}(?: ± {NUMBER})? %)"
        for what, begin in (("changed", "Played so, "), ("real", "as it was struck, ")):
            if found := re.search(begin + form, text):
                yield state(("chance", "real" if is_real else what, f"{is_real}"), found[1], source)
            chance = document[what]["probability"]
            yield state(("chance", "real" if is_real else what, f"{is_real}"), chance, "JSON of what-if")
        result = re.search("The real shot (scored|did not)", text)
        if document["goal"]["game"] == "pot" and is_single and result:
            is_potted = any(one["kind"] == "pocket" and one["a"] != cue and float(one["probability"]) >= MIN_PROBABILITY
                            for one in self.events)  # fmt: skip
            yield state(("scored",), "scored" if is_potted else "did not", "events.csv")
            yield state(("scored",), result[1], source)
        if found := re.search(rf"end with the clip, at ({NUMBER} s).* at most to ({NUMBER} s)", text):
            yield state(("end of the observations",), found[1], source)
            yield state(("end of the plays", f"{is_real}"), found[2], source)
            yield state(("end of the plays", f"{is_real}"), document["play_end"], "JSON of what-if")
        listed = re.search(r"(?:Played so|In the film): (.*?)\. ", raw)
        clauses = listed[1].split(", ") if listed and listed[1] != "nothing is met" else []
        yield from self.read_filmed(document, clauses, is_single) if is_real else self.read_plays(document, clauses)

    def read_filmed(self, document: dict[str, Any], clauses: list[str], is_single: bool) -> Iterator[Statement]:
        """Read the events of a what-if without a change, which are those of the run."""
        read = list(self.read_rows(clauses, "terminal of what-if"))
        yield from read
        for what in ("real", "changed"):
            for one in document[what]["events"]:
                key = self.find_event(one["kind"], one["a"], one["b"], one["t"])
                names = {"time": "t", "time sigma": "t_sigma", "probability": "probability"}
                yield from (state((name, key), one[of_it], "JSON of what-if") for name, of_it in names.items())
        met = {one.key[1] for one in read if one.key[0] == "event"}
        for row in self.events if is_single else ():
            event = self.find_event(row["kind"], row["a"], row["b"], float(row["t"]))
            if row["kind"] in ("ball", "cushion", "pocket") and event not in met:
                yield state(("event", event), "absent", "terminal of what-if")

    def read_plays(self, document: dict[str, Any], clauses: list[str]) -> Iterator[Statement]:
        """Read the events of the plays of a what-if with a change."""
        times = [(one["kind"], {one["a"], one["b"]} - {""}, one["t"]) for one in document["changed"]["events"]]
        for shown in map(self.identify, clauses):
            found = next(((kind, one) for kind, verb in EVENT_VERBS.items() if (one := re.search(verb, shown))), None)
            moment = re.search(rf" at ({NUMBER} s) ±", shown)
            if found is None or moment is None:
                yield state(("form of a play",), shown, "terminal of what-if")
                yield state(("form of a play",), "an event", "JSON of what-if")
                continue
            bodies, t = [one for one in found[1].groups() if one], float(moment[1].split()[0])
            kind = "cushion" if found[0] == "ball" and bodies[-1] in CUSHIONS else found[0]
            own = [one[2] for one in times if one[0] == kind and one[1] == set(bodies)]
            key = f"{kind} {' '.join(bodies)} {moment[1]}"
            yield state(("played time", key), moment[1], "terminal of what-if")
            nearest = min(own, key=lambda one: abs(one - t), default="none")
            yield state(("played time", key), nearest, "JSON of what-if")


def read_certificate(
    document: dict[str, Any], table: Iterable[Iterable[str]], sentence: str, page: list[str]
) -> Iterator[Statement]:
    """Read a certificate from its JSON, the table and the sentence of its terminal, and its page."""
    ids = {words: name for name, words in NAMES.items()}
    for name, one in document["numbers"].items():
        for what in ("value", "sigma"):
            number = one[what] if one["value"] is not None else "not determined"
            yield state(("certificate", name, what), number, "JSON of certify")
        yield state(("certificate", name, "unit"), one["unit"], "JSON of certify")
    beneath = page[: next((k for k, row in enumerate(page) if row.startswith("Pocket openings")), len(page))]
    rows = [("page of certify", [cell.strip() for cell in row.strip("| ").split("|")]) for row in beneath]
    for source, cells in (*(("terminal of certify", [*row]) for row in table), *rows):
        if cells[0] in ids and len(cells) >= 4:
            name, (value, sigma, unit) = ids[cells[0]], cells[1:4]
            negative = f" {FALLS[name][1]}" if name in FALLS else "no direction"
            is_negative = value.endswith(negative)
            for end in FALLS.get(name, ()):
                value = value.removesuffix(f" {end}")
            value = "not determined" if value.startswith("not determined") else f"{'-' * is_negative}{value}"
            yield state(("certificate", name, "value"), value, source)
            yield state(("certificate", name, "sigma"), "not determined" if sigma == "–" else sigma, source)
            yield state(("certificate", name, "unit"), unit, source)
    counts = {"shots": r"^(\d+) shots?", "cushion_contacts": r"with (\d+) cushion contacts?"}
    for source, text in (("terminal of certify", sentence), *(("page of certify", row.strip("| ")) for row in page)):
        if "on this table" in text:
            for name, pattern in counts.items():
                yield from (state(("certificate", name), one, source) for one in re.findall(pattern, text))
                yield state(("certificate", name), document[name], "JSON of certify")
            for name, pattern in CERTIFICATE_CLAUSES.items():
                for value, sigma in re.findall(pattern, text):
                    yield state(("certificate", name, "value"), value, source)
                    yield state(("certificate", name, "sigma"), sigma, source)
            for size in re.findall(rf"it falls by ({NUMBER}) mm/m", text):
                slope = (document["numbers"][name]["value"] for name in FALLS)
                yield state(("certificate", "slope"), size, source)
                yield state(("certificate", "slope"), math.hypot(*slope), "JSON of certify")


def ask(answer: Answer) -> tuple[dict[str, Any], str]:
    """Print an answer as the terminal and as JSON."""
    printed = []
    for as_json in (True, False):
        with contextlib.redirect_stdout(io.StringIO()) as text:
            command_line.print_answer(answer, as_json)
        printed.append(text.getvalue())
    return json.loads(printed[0]), printed[1]


def list_questions(events: list[dict[str, str]], balls: list[str], pockets: bool) -> list[tuple[str, ...]]:
    """List the questions that make sense: touching pairs, first ball and cushion of moved balls, pockets, a line."""
    moved = sorted({one["a"] for one in events} | {one["b"] for one in events if one["kind"] == "ball"})
    pairs = {tuple(sorted((one["a"], one["b"]))) for one in events if one["kind"] == "ball"}
    apart = [pair for pair in combinations(sorted(balls), 2) if pair not in pairs][:1]
    questions = [("contact", *pair) for pair in (*sorted(pairs), *apart)]
    questions += [(kind, ball) for kind in ("first", "cushion-first") for ball in moved]
    potted = [(one["a"], one["b"]) for one in events if one["kind"] == "pocket"]
    questions += [("pocket", *pair) for pair in (potted or [(moved[0], "top-left")] if moved else []) if pockets]
    return questions + [("line", "x=0.8", ball) for ball in moved[:1]]


def collect_statements(folder: Path, commands: Iterable[str]) -> tuple[list[Statement], dict[str, str]]:
    """Collect the statements of all outputs of one run folder, and why commands refuse."""
    record = read_shot_record(folder)
    with (folder / "events.csv").open(newline="", encoding="utf-8") as file:
        events = list(csv.DictReader(file))
    with (folder / "tracks.csv").open(newline="", encoding="utf-8") as file:
        end = max(float(row["t"]) for row in csv.DictReader(file))
    run = RunStatements(folder, record.naming, events, tuple(one.ball for one in record.explanation.moments))
    shots = json.loads((folder / "scene.json").read_text(encoding="utf-8"))["shot_numbers"]
    found = [*run.read_events(), state(("end of the observations",), end, "tracks.csv")]
    found += run.read_numbers([one for shot in shots[:1] for one in shot["numbers"]], "scene.json")
    found += run.read_rows(PageRows((folder / "report.html").read_text(encoding="utf-8")).rows(), "report")
    log = folder.parent / f"{folder.name}.log"
    if log.is_file():
        found += run.read_rows(log.read_text(encoding="utf-8").splitlines(), "terminal of run")
    refusals = {}
    with tempfile.TemporaryDirectory() as out:
        for command in commands:
            try:
                found += ask_command(run, command, Path(out), record.table, shots)
            except TruerollError as error:
                refusals[command] = str(error)
    return found, refusals


def ask_command(run: RunStatements, command: str, out: Path, table: Table, shots: list[Any]) -> list[Statement]:
    """Ask one command everything, and read its statements."""
    found: list[Statement] = []
    is_single = len(shots) == 1
    if command == "call":
        for question in list_questions(run.events, list(run.naming.looks), table.pockets):
            figure: list[str] = []

            def keep(nearest: Any, head: str, lines: list[str], figure: list[str] = figure) -> Any:
                figure += [head, *lines]
                return draw_close_up(nearest, head, lines)

            with patch(CLOSE_UP, keep):
                document, printed = ask(trueroll.call(run.folder, *question, out=out))
            found += run.read_calls(document, printed.split("\n")[0], figure)
    elif command == "put-back":
        answer = trueroll.put_back(run.folder, out=out)
        found += run.read_places(ask(answer)[0], [list(row) for row in answer.rows])
    elif command == "compare":  # the numbers of several shots are not those of one
        answer = trueroll.compare(run.folder, out=out / "session")
        numbers = shots[0]["numbers"] if is_single else []
        found += run.read_session(ask(answer)[0], [list(row) for row in answer.rows], numbers)
        with (out / "session" / "session.csv").open(newline="", encoding="utf-8") as file:
            listed = list(csv.DictReader(file))
        page = PageRows((out / "session" / "session.html").read_text(encoding="utf-8"))
        found += run.read_session_page(page.rows(), listed, shots)
    elif command == "predict":
        document, printed = ask(trueroll.predict(run.folder, out=out))
        found += run.read_predictions(document, printed.splitlines()[: len(document["balls"])], table)
    elif command == "what-if":
        for more in (None, "+10%"):
            answer = trueroll.what_if(run.folder, out=out, speed=more, side=more, top=more)
            found += run.read_what_if(ask(answer)[0], ask(answer)[1].splitlines(), is_single)
    elif command == "certify":
        answer = trueroll.certify(run.folder, out=out)
        page = PageRows((out / "certificate.html").read_text(encoding="utf-8"))
        found += read_certificate(ask(answer)[0], answer.rows, answer.sentences[0], page.rows())
    return found


def find_silent(statements: Iterable[Statement], outputs: Iterable[str]) -> list[str]:
    """Find the outputs of which nothing is compared: whose statements no other output makes, or that have none."""
    sources: dict[tuple[str, ...], set[str]] = defaultdict(set)
    for one in statements:
        sources[one.key].add(one.source)
    compared = {source for same in sources.values() if len(same) > 1 for source in same}
    return [one for one in outputs if not any(f" of {source}".endswith(f" of {one}") for source in compared)]


def find_contradictions(statements: Iterable[Statement]) -> list[tuple[str, Statement, Statement]]:
    """Find what differs between two outputs: one pair of statements for each quantity."""
    by_key: dict[tuple[str, ...], list[Statement]] = defaultdict(list)
    for one in statements:
        by_key[one.key].append(one)
    found = []
    for key, same in by_key.items():
        pairs = [(kind, one, two) for one, two in combinations(same, 2) if (kind := one.find_difference(two))]
        found += pairs[:1]
        if key[0].startswith("event") and key[1].endswith("?"):
            found.append(("event", same[0], same[0]))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="Run folders, or folders of run folders.")
    parser.add_argument("--commands", default=",".join(COMMANDS), help="Commands to ask, separated by commas.")
    arguments = parser.parse_args()
    total = 0
    print(f"{'run':44}{'statements':>12}{'compared':>10}{'contradictions':>16}")
    for folder in list_folders_with("report.html", [one for one in arguments.folders if one.is_dir()]):
        commands = arguments.commands.split(",")
        statements, refusals = collect_statements(folder, commands)
        counts: dict[tuple[str, ...], set[str]] = defaultdict(set)
        for one in statements:
            counts[one.key].add(one.source)
        pairs = find_contradictions(statements)
        total += len(pairs)
        compared = sum(len(sources) > 1 for sources in counts.values())
        print(f"{folder.name:44}{len(statements):12}{compared:10}{len(pairs):16}", flush=True)
        for kind, one, two in pairs:
            stated = (f"{found.words} ({found.source})" for found in (one, two))
            print(f"    {kind}: {' / '.join(one.key)}: {', '.join(stated)}", flush=True)
        answered = [one for one in commands if one not in refusals]
        silent = find_silent(statements, ["report", "events.csv", *answered])
        total += len(silent)
        for command in silent:
            print(f"    NOTHING COMPARED: no statement of {command} was found in another output", flush=True)
        for command, why in refusals.items():
            print(f"    not compared: {command} refuses: {why}", flush=True)
    return int(total > 0)


if __name__ == "__main__":
    sys.exit(main())
