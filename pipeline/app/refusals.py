"""Refusals of requests as one sentence, and the reading of requests that may hold anything."""

from __future__ import annotations

import json
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse

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


async def read_json_body(request: Request, limit: int = MAX_JSON_BYTES) -> dict[str, Any]:
    """Read the JSON object of a request.

    Args:
        limit: Largest size, bytes.

    Returns:
        The object; empty for an empty body.

    Raises:
        Refusal: It is too large, or no JSON object.
    """
    content = b""
    async for part in request.stream():
        content += part
        if len(content) > limit:
            raise Refusal(413, f"At most {limit // 1000} kB of JSON were expected; the request holds more.")
    try:
        document = json.loads(content.decode("utf-8")) if content else {}
    except (ValueError, RecursionError) as error:
        raise Refusal(422, "A JSON object was expected; the request holds other text.") from error
    if not isinstance(document, dict):
        raise Refusal(422, "A JSON object was expected; the request holds another value.")
    return document
