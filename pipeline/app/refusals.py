"""Refusals of requests as one sentence, and the reading of requests that may hold anything."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.types import ExceptionHandler

from models.core.errors import TruerollError

# Largest JSON document of a request, bytes: corrections of a long clip take less.
MAX_JSON_BYTES = 2_000_000


class Refusal(Exception):
    """A request that cannot be fulfilled, and why."""

    def __init__(self, status: int, sentence: str) -> None:
        super().__init__(sentence)
        self.status = status
        """Status of HTTP."""
        self.sentence = sentence

    def to_response(self) -> JSONResponse:
        """Return the answer to the request."""
        return JSONResponse({"error": self.sentence}, self.status)


def refuse_status(status: int) -> Refusal:
    """Make the refusal of a request that a library refuses by its status alone."""
    words = {404: "There is nothing at this address.", 405: "This address takes no such request.",
             416: "This file has no such part."}  # fmt: skip
    return Refusal(status, words.get(status, "This request cannot be understood."))


async def read_body(request: Request) -> bytes:
    """Read the body of a request that holds JSON; raises Refusal where it is too large."""
    content = b""
    async for part in request.stream():
        content += part
        if len(content) > MAX_JSON_BYTES:
            raise Refusal(413, f"At most {MAX_JSON_BYTES // 1000} kB of JSON were expected; the request holds more.")
    return content


async def read_json_body(request: Request) -> dict[str, Any]:
    """Read the JSON object of a request.

    Returns:
        The object; empty for an empty body.

    Raises:
        Refusal: It is too large, or no JSON object.
    """
    content = await read_body(request)
    try:
        document = json.loads(content.decode("utf-8")) if content else {}
    except (ValueError, RecursionError) as error:
        raise Refusal(422, "A JSON object was expected; the request holds other text.") from error
    if not isinstance(document, dict):
        raise Refusal(422, "A JSON object was expected; the request holds another value.")
    return document


async def _answer_refusal(request: Request, error: Exception) -> Response:
    assert isinstance(error, Refusal)
    return error.to_response()


async def _answer_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return refuse_status(error.status_code).to_response()


async def _answer_error(request: Request, error: Exception) -> Response:
    from pipeline.reporting.text.text_formatting import format_error  # slow to import, and only refusals need it

    return Refusal(422, format_error(error, for_page=True).rstrip(".") + ".").to_response()


async def _answer_fault(request: Request, error: Exception) -> Response:
    return Refusal(500, f"This failed by a fault of the program ({type(error).__name__}).").to_response()


# What answers an exception, in the server and in the process that answers questions.
EXCEPTION_HANDLERS: Mapping[Any, ExceptionHandler] = {
    Refusal: _answer_refusal, HTTPException: _answer_http, TruerollError: _answer_error, Exception: _answer_fault
}  # fmt: skip
