"""Answers about one shot for the page: the functions behind the commands, with the same sentences.

Everything is computed in threads, few at a time, so that the server goes on to answer other requests.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar
from urllib.parse import urlencode

import numpy as np
from anyio import CapacityLimiter, to_thread
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from models.core.answer import Answer
from models.core.ball_look import format_colour
from models.core.corrections import NO_CORRECTIONS
from models.core.errors import TruerollError
from models.core.number_format import format_time
from models.core.rally import Rally
from models.estimation.contact_test.rule_answers import find_struck_ball
from models.estimation.contact_test.shot_record import REST_SPEED
from pipeline.actions.answer_call import answer_question, state_call, trace_mark, write_call_images
from pipeline.actions.judge_rally import state_rally_call, write_landing_picture
from pipeline.actions.placement_views import format_place_from_rails, state_wanted_places
from pipeline.actions.play_otherwise import PLAYS, PlayedShot, StrokePlan
from pipeline.actions.predict_rally import state_flight_prediction
from pipeline.actions.predict_shot import state_prediction
from pipeline.actions.put_back import locate_wanted_places
from pipeline.actions.share_call import write_share_clip
from pipeline.actions.stroke_options import choose_spread, parse_change
from pipeline.app.open_shots import PREDICTED_S, QUICK_PLAYS, OpenShot, ShotDesk
from pipeline.app.refusals import Refusal, read_json_body
from pipeline.app.shot_document import describe_rally, describe_shot, list_paths
from pipeline.app.shot_library import SHARE_FOLDER
from pipeline.editing.edit_session import ConflictError, EditSession
from pipeline.io.corrections_file import SCHEMA, parse_corrections
from pipeline.io.strict_json import replace_nonfinite
from pipeline.reporting.text.call_sentences import format_call
from pipeline.reporting.text.text_formatting import format_error, format_meeting, start_sentence

# Computations, and decodings of frames, that run at the same time: a page must not use up the machine.
COMPUTING, DECODING = 2, 2
# Questions of the page in the words of `trueroll call`, where they differ.
CALL_WORDS = {"touch": "contact"}
# Characters of the longest word of a question.
LONGEST_WORD = 64
# Files of a run that are shared with every answer.
SHARED_RUN_FILES = ("slow.mp4", "poster.png", "report.html")
# s that are predicted at most.
LONGEST_PREDICTION_S = 60.0
# Changes of a stroke by their names in a request, with their names in `trueroll what-if` and their units there.
STROKE_CHANGES = {"speed_percent": ("speed", "%"), "angle_deg": ("angle", "deg"), "side_percent": ("side", "%"),
                  "top_percent": ("top", "%")}  # fmt: skip
MODELS_COMING = (
    "Contact models of the whole shot are being computed; until then side spin is not known, and chances may change."
)

V = TypeVar("V")


def build_routes(desk: ShotDesk) -> list[BaseRoute]:
    """Build the routes below `api`."""
    handlers = ShotHandlers(desk)
    return [
        Route("/shots/{id}", handlers.send_shot),
        Route("/shots/{id}/frame/{number:int}", handlers.send_frame),
        Route("/shots/{id}/ask", handlers.ask, methods=["POST"]),
        Route("/shots/{id}/picture", handlers.send_picture),
        Route("/shots/{id}/predict", handlers.predict, methods=["POST"]),
        Route("/shots/{id}/what-if", handlers.play_otherwise, methods=["POST"]),
        Route("/shots/{id}/put-back", handlers.put_back),
        Route("/shots/{id}/share", handlers.share, methods=["POST"]),
        Route("/shots/{id}/status", handlers.send_status),
        Route("/shots/{id}/corrections", handlers.change_corrections, methods=["PUT"]),
        *(Route(f"/shots/{{id}}/{name}", handlers.step, methods=["POST"]) for name in ("undo", "redo")),
        Route("/shots/{id}/finish", handlers.finish, methods=["POST"]),
    ]


class Question:
    """A question of the page about a shot."""

    def __init__(self, given: Mapping[str, Any]) -> None:
        """Read the question of a request; raises Refusal where it is malformed."""
        self.kind, self.a, self.b, self.on = (_read_word(given, name) for name in ("question", "a", "b", "on"))

    @property
    def words(self) -> list[str]:
        """The question as `trueroll call` takes it."""
        return [CALL_WORDS.get(self.kind, self.kind), *filter(None, (self.a, self.b))]

    @property
    def values(self) -> dict[str, str]:
        """The values that a request needs to ask it again."""
        named = {"question": self.kind, "a": self.a, "b": self.b, "on": self.on}
        return {name: value for name, value in named.items() if value}


class ShotHandlers:
    """Handlers of the answers about a shot."""

    def __init__(self, desk: ShotDesk) -> None:
        self._desk = desk
        self._computing, self._decoding = CapacityLimiter(COMPUTING), CapacityLimiter(DECODING)

    async def _compute(self, function: Callable[..., V], *arguments: Any) -> V:
        """Compute in a thread, when it is this one's turn."""
        return await to_thread.run_sync(function, *arguments, limiter=self._computing)

    async def send_shot(self, request: Request) -> Response:
        """Send all that the page shows of a shot; the ETag is the revision of its corrections."""
        document = await self._compute(self._describe, request.path_params["id"])
        return _send(document, {"ETag": f'"{document["revision"]}"'})

    def _describe(self, shot: str) -> dict[str, Any]:
        opened = self._desk.open(shot)
        own = {"id": shot, "version": _name_version(opened), "name": self._desk.name_shot(opened)}
        session: EditSession | None = None
        why_not = ""
        try:
            session = self._desk.open_session(shot)
        except (TruerollError, OSError) as error:
            why_not = f"This shot cannot be corrected: {format_error(error, for_page=True)}"
        if isinstance(opened.saved, Rally):
            return describe_rally(opened, session, why_not) | own
        opened.warm_up()
        return describe_shot(opened, session, why_not) | own

    async def send_frame(self, request: Request) -> Response:
        """Send a frame as JPEG."""
        shot, number = request.path_params["id"], request.path_params["number"]
        content = await to_thread.run_sync(lambda: self._desk.open(shot).read_frame(number), limiter=self._decoding)
        if content is None:
            raise Refusal(404, "There is no such frame.")
        return Response(content, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=3600"})

    async def ask(self, request: Request) -> Response:
        """Answer a question as `trueroll call` does."""
        shot, question = request.path_params["id"], Question(await read_json_body(request))
        return _send(await self._compute(self._answer, shot, question))

    def _answer(self, shot: str, question: Question) -> dict[str, Any]:
        opened = self._desk.open(shot)
        if isinstance(opened.saved, Rally):
            answer, landing = state_rally_call(opened.saved, question.words, None, opened.folder)
            balls: list[str] = []
            has_picture = landing is not None and landing.landing is not None
        else:
            words = _complete_words(opened, question)
            call = answer_question(opened.record, words, on=question.on)
            answer = state_call(opened.record, call, words, question.on)
            balls = list(call.balls)
            has_picture = math.isfinite(call.t) and opened.record.camera is not None
        version = {"version": _name_version(opened)}
        picture = f"api/shots/{shot}/picture?{urlencode(question.values | version)}"
        return _describe_answer(answer) | {
            "balls": balls, "picture": picture if has_picture and opened.has_clip else None
        }  # fmt: skip

    async def send_picture(self, request: Request) -> Response:
        """Send the close-up of the moment that a question is about, as PNG."""
        content = await self._compute(self._draw, request.path_params["id"], Question(request.query_params))
        return Response(content, media_type="image/png", headers={"Cache-Control": "private, max-age=3600"})

    def _draw(self, shot: str, question: Question) -> bytes:
        with TemporaryDirectory(prefix="trueroll-app-") as folder:
            paths = _write_pictures(self._desk.open(shot), question, Path(folder))
            return paths[0].read_bytes()

    async def predict(self, request: Request) -> Response:
        """Predict the rest of a shot as `trueroll predict` does."""
        body = await read_json_body(request)
        at, seconds = _read_number(body, "at"), _read_number(body, "seconds")
        seconds = PREDICTED_S if seconds is None else seconds
        if not 0 < seconds <= LONGEST_PREDICTION_S:
            raise Refusal(422, f"seconds is above 0 and at most {LONGEST_PREDICTION_S:g}.")
        return _send(await self._compute(self._predict, request.path_params["id"], at, seconds))

    def _predict(self, shot: str, at: float | None, seconds: float) -> dict[str, Any]:
        opened = self._desk.open(shot)
        if isinstance(opened.saved, Rally):
            path, answer = state_flight_prediction(
                opened.saved, seconds, at, NO_CORRECTIONS if at is None else opened.corrections
            )
            name = opened.saved.scene.sport.object.name
            return _describe_answer(answer) | {"paths": list_paths([name], path.t, path.xyz[:, None])}
        record = opened.record
        speeds = [] if at is None else [record.speed_at(k, at) for k in range(len(record.ids))]
        if at is not None and at <= record.moments[-1] and not any(speed > REST_SPEED for speed in speeds):
            raise Refusal(422, "Nothing moves at this moment; choose one after the stroke.")
        predicted = opened.predict(at, seconds)
        answer, prediction = state_prediction(predicted), predicted.prediction
        paths = np.stack([fan.medoid_path for fan in predicted.draw_fans()], axis=1)
        return _describe_answer(answer) | {
            "at": prediction.state.t,
            "paths": list_paths(prediction.state.ids, prediction.t, paths),
            "spread": [{"id": one["id"], **one["end"]} for one in answer.document["balls"] if one["end"]],
            "events": _describe_events(opened, answer.document["events"], prediction.t, paths, prediction.state.ids),
        }  # fmt: skip

    async def play_otherwise(self, request: Request) -> Response:
        """Play a stroke otherwise as `trueroll what-if` does; with few plays where `is_quick`, as a slider moves."""
        body = await read_json_body(request)
        return _send(await self._compute(self._play, request.path_params["id"], body))

    def _play(self, shot: str, body: dict[str, Any]) -> dict[str, Any]:
        opened = self._desk.open(shot)
        stroke = _read_number(body, "stroke") or 1
        if stroke != int(stroke) or stroke < 1:
            raise Refusal(422, "stroke is the number of a stroke, from 1.")
        amounts = {name: (option, unit, _read_number(body, name)) for name, (option, unit) in STROKE_CHANGES.items()}
        texts = {option: f"{value:+.6f}{unit}" for option, unit, value in amounts.values() if value}
        spread = _read_word(body, "spread")
        game = _read_word(body, "game")
        plan = StrokePlan(
            parse_change(**texts), *choose_spread(spread or None), game or None,  # type: ignore[arg-type]
            _read_word(body, "ball"), _read_word(body, "pocket"),
        )  # fmt: skip
        is_quick = body.get("is_quick") is True
        is_coming = not is_quick and opened.fit_laws()  # the search would slow down a slider that moves
        played = opened.play(int(stroke) - 1, plan, QUICK_PLAYS if is_quick else PLAYS)
        return _describe_plays(opened, played, is_coming, is_quick)

    async def put_back(self, request: Request) -> Response:
        """Send where the balls lay at a frame, or just before the strike, as `trueroll put-back` does."""
        frame = request.query_params.get("frame", "")
        if frame and not (frame.isdecimal() and len(frame) < 10):
            raise Refusal(422, "frame is the number of a frame.")
        return _send(await self._compute(self._locate, request.path_params["id"], int(frame) if frame else None))

    def _locate(self, shot: str, frame: int | None) -> dict[str, Any]:
        opened = self._desk.open(shot)
        record = opened.record
        at = None if frame is None else float(record.shown[int(np.argmin(np.abs(record.frame - frame)))])
        wanted = locate_wanted_places(record, at)
        answer, places, radius = state_wanted_places(wanted), wanted.places, wanted.table.ball_radius
        looks = [wanted.naming.find_look(name) for name in places.ids]
        camera = wanted.camera
        px = None if camera is None else camera.to_pixels(places.xy, radius)
        size = None if camera is None else camera.radius_px(places.xy, radius)
        return _describe_answer(answer) | {
            "t": places.t, "frame": int(wanted.frame), "absent": list(places.absent),
            "balls": [
                {
                    "id": name, "name": wanted.naming.name_ball(name), "colour": format_colour(looks[k].colour),
                    "px": None if px is None else px[k], "radius_px": None if size is None else float(size[k]),
                    "xy": places.xy[k], "sigma_mm": 1e3 * float(np.hypot(*wanted.place_sigma[k]) / math.sqrt(2)),
                    "text": format_place_from_rails(wanted, k),
                }
                for k, name in enumerate(places.ids)
            ],
        }  # fmt: skip

    async def share(self, request: Request) -> Response:
        """Write what can be shared of an answer, or of the whole shot, and send where it is."""
        body = await read_json_body(request)
        question = Question(body) if body.get("question") else None
        return _send({"files": await self._compute(self._share, request.path_params["id"], question)})

    def _share(self, shot: str, question: Question | None) -> list[dict[str, Any]]:
        opened = self._desk.open(shot)
        files = []
        if question is not None:
            pictures = _write_pictures(opened, question, opened.folder / SHARE_FOLDER)
            if not isinstance(opened.saved, Rally):
                clip = pictures[0].with_suffix(".mp4")
                words = _complete_words(opened, question)
                call = answer_question(opened.record, words, on=question.on)
                text, mark = format_call(call, opened.record.naming), trace_mark(opened.record, call)
                write_share_clip(opened.record, call, text, mark, opened.shot, opened.clip, clip)
                pictures.insert(0, clip)
            files = [(path, f"api/shots/{shot}/shared/{path.name}") for path in pictures]
        own = [opened.folder / name for name in SHARED_RUN_FILES]
        files += [(path, f"api/shots/{shot}/file/{path.name}") for path in own if path.is_file()]
        return [{"name": path.name, "address": place, "bytes": path.stat().st_size} for path, place in files]

    async def send_status(self, request: Request) -> Response:
        """Send progress and revision of the corrections."""
        session = await self._open_session(request)
        return _send(asdict(session.status))

    async def change_corrections(self, request: Request) -> Response:
        """Replace the corrections by those of the request, which must name their revision in If-Match."""
        document = await read_json_body(request)
        try:
            corrections = parse_corrections({"schema": SCHEMA, **document}).corrections
        except (ValueError, RecursionError, OverflowError) as error:
            raise Refusal(422, f"The correction cannot be used: {' '.join(str(error).split())}.") from error
        return await self._change(request, lambda session, revision: session.change(corrections, revision))

    async def step(self, request: Request) -> Response:
        """Undo the last correction, or redo the one that was undone last."""
        forward = request.url.path.endswith("redo")
        return await self._change(request, lambda session, revision: session.step(revision, forward=forward))

    async def finish(self, request: Request) -> Response:
        """Start the stages that write video, report and recording."""
        session = await self._open_session(request)
        session.finish()
        return _send(asdict(session.status))

    async def _open_session(self, request: Request) -> EditSession:
        return await self._compute(self._desk.open_session, request.path_params["id"])

    async def _change(self, request: Request, change: Callable[[EditSession, int], None]) -> Response:
        """Make a change to the revision that the request names."""
        try:
            revision = int(request.headers.get("if-match", "").strip('"'))
        except ValueError as error:
            sentence = "A change names the revision that it is made to, in the header If-Match."
            raise Refusal(428, sentence) from error
        session = await self._open_session(request)
        try:
            await self._compute(change, session, revision)
        except ConflictError as error:
            raise Refusal(412, str(error)) from error
        status = session.status
        return _send(asdict(status), {"ETag": f'"{status.revision}"'})


def _name_version(opened: OpenShot) -> str:
    """Name what a run folder holds now; addresses of images that a browser may keep have it as `version`."""
    return opened.digest[:16]


def _send(document: Mapping[str, Any], headers: Mapping[str, str] | None = None) -> Response:
    """Send JSON values; NaN becomes null."""
    content = json.dumps(replace_nonfinite(document), allow_nan=False, separators=(",", ":"))
    return Response(content, media_type="application/json", headers=headers)


def _read_word(given: Mapping[str, Any], name: str) -> str:
    """Read a text of a request; empty where it is missing."""
    value = given.get(name) or ""
    if not isinstance(value, str) or len(value) > LONGEST_WORD:
        raise Refusal(422, f"{name} is a text of at most {LONGEST_WORD} characters.")
    return value


def _read_number(given: Mapping[str, Any], name: str) -> float | None:
    """Read a number of a request; None where it is missing."""
    value = given.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
        raise Refusal(422, f"{name} is a number.")
    return float(value)


def _complete_words(opened: OpenShot, question: Question) -> list[str]:
    """Return the words of a question; the struck ball is meant where the first contact of no ball is asked for."""
    if question.kind != "first" or question.a:
        return question.words
    struck = find_struck_ball(opened.record)
    if not struck:
        raise Refusal(422, "The clip does not show which ball was struck; name one.")
    return ["first", struck]


def _write_pictures(opened: OpenShot, question: Question, folder: Path) -> list[Path]:
    """Write the images of the moment that a question is about; raises Refusal where there are none."""
    if isinstance(opened.saved, Rally):
        _, landing = state_rally_call(opened.saved, question.words, None, opened.folder)
        if landing is None or landing.landing is None:
            raise Refusal(404, "No image: the answer has no place.")
        return [Path(one) for one in write_landing_picture(opened.saved, landing, opened.clip, folder)]
    words = _complete_words(opened, question)
    call = answer_question(opened.record, words, on=question.on)
    text = format_call(call, opened.record.naming)
    words = [*words, *(("on", question.on) if question.on else ())]
    paths, why_not = write_call_images(opened.record, call, text, opened.clip, folder, words)
    if not paths:
        raise Refusal(404, f"No image: {why_not}")
    return paths


def _describe_answer(answer: Answer) -> dict[str, Any]:
    """Describe an answer as the page shows it."""
    values = {one.name: one for one in answer.quantities if not one.ball}
    time, margin = values.get("time"), values.get("margin")
    return {
        "question": answer.question, "sentence": answer.sentences[0], "sentences": list(answer.sentences),
        "verdict": answer.verdict, "probability": answer.probability,
        "t": None if time is None else time.value, "t_sigma": None if time is None else time.sigma,
        "frame": answer.document.get("frame"),
        "margin_mm": None if margin is None else margin.value,
        "margin_sigma_mm": None if margin is None else margin.sigma,
        "reasons": [*answer.sentences[1:], *answer.notes], "rows": [list(map(str, row)) for row in answer.rows],
    }  # fmt: skip


def _describe_plays(opened: OpenShot, played: PlayedShot, is_coming: bool, is_quick: bool) -> dict[str, Any]:
    """Describe a shot that was played otherwise; paths are those of the most typical plays."""
    ensemble, answer = played.struck.ensemble, played.answer
    t = ensemble.t + played.changed.t
    paths = np.stack([fan.medoid_path for fan in played.draw_fans()], axis=1)
    chances = {
        name: {"probability": one.value, "sigma": one.sigma}
        for name, one in zip(("as_struck", "otherwise"), answer.quantities, strict=True)
    }
    coming = [MODELS_COMING] if is_coming and not ensemble.is_whole_shot else []
    return _describe_answer(answer) | {
        "sentences": [*answer.sentences, *coming], "is_final": not (coming or is_quick),
        "model": answer.document["model"], "t": ensemble.t, "cue": ensemble.ids[ensemble.cue],
        "draws": len(ensemble.members), "chance": chances, "stroke": answer.document["stroke"],
        "paths": list_paths(ensemble.ids, t, paths),
        "events": _describe_events(opened, answer.document["changed"]["events"], t, paths, ensemble.ids),
    }  # fmt: skip


def _describe_events(
    opened: OpenShot, events: list[dict[str, Any]], t: np.ndarray, paths: np.ndarray, ids: tuple[str, ...]
) -> list[dict[str, Any]]:
    """Describe events that may happen, with their places on the typical paths (T, N, 2), m."""
    naming, described = opened.fit.naming, []
    for one in events:
        path = paths[:, ids.index(one["a"])]
        is_finite = np.isfinite(path[:, 0])
        x, y = (
            (float(np.interp(one["t"], t[is_finite], path[is_finite, k])) for k in range(2))
            if is_finite.any()
            else (None, None)
        )
        what = f"{naming.say(one['a'])} {format_meeting(one['kind'], one['b'], naming)}"
        text = f"{format_time(one['t'], one['t_sigma'])}: {start_sentence(what)}"
        described.append(one | {"x": x, "y": y, "text": text})
    return described
