"""Request id and trace context, which a job carries to the worker and to webhooks."""

import re
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request

from service.http.problems import request_id_of

TRACEPARENT = "dynamictree.traceparent"
"""Where tracing may leave the context of its own span in a request's scope."""

_TRACEPARENT = re.compile(r"[0-9a-f]{2}-[0-9a-f]{32}-[0-9a-f]{16}-[0-9a-f]{2}")


@dataclass(frozen=True, kw_only=True)
class RequestOrigin:
    """Request id and trace context of one request."""

    request_id: str | None
    traceparent: str | None


async def _origin_of(request: Request) -> RequestOrigin:
    given = request.scope.get(TRACEPARENT) or request.headers.get("traceparent", "")
    match = _TRACEPARENT.fullmatch(given)
    return RequestOrigin(request_id=request_id_of(request.scope), traceparent=match.group() if match else None)


Origin = Annotated[RequestOrigin, Depends(_origin_of)]
