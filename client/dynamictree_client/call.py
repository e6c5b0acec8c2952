"""A request and the type of its response, independent of transport; both clients share it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar
from urllib.parse import quote

import httpx
from pydantic import BaseModel, TypeAdapter
from pydantic_core import to_json

from dynamictree_client.errors import problem_of

T = TypeVar("T")
IDEMPOTENT = ("GET", "HEAD", "PUT", "DELETE", "OPTIONS")


@dataclass(frozen=True, kw_only=True)
class Call(Generic[T]):
    """An operation with its arguments, to be sent by `Client.send`."""

    method: str
    path: str
    answer: Any  # type T of the response, at run time
    query: Mapping[str, object] = field(default_factory=dict)
    headers: Mapping[str, object] = field(default_factory=dict)
    body: BaseModel | Mapping[str, Any] | None = None
    content: bytes | None = None
    content_type: str | None = None

    @property
    def repeatable(self) -> bool:
        """Return whether the request is idempotent."""
        return self.method in IDEMPOTENT or self.headers.get("idempotency-key") is not None

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of httpx's `request`."""
        headers = {name: str(value) for name, value in self.headers.items() if value is not None}
        query = {name: _query_text(value) for name, value in self.query.items() if value is not None}
        given: dict[str, Any] = {"method": self.method, "url": self.path, "params": query, "headers": headers}
        if self.body is not None:
            body = self.body
            given["content"] = (
                body.model_dump_json(exclude_unset=True).encode() if isinstance(body, BaseModel) else to_json(body)
            )
            headers["content-type"] = "application/json"
        elif self.content is not None:
            given["content"] = self.content
            headers["content-type"] = self.content_type or "application/octet-stream"
        return given

    def read(self, response: httpx.Response) -> T:
        """Parse the response.

        Raises:
            ProblemError: the service reports a problem.
        """
        if response.is_error:
            raise problem_of(response)
        if self.answer is None or response.status_code == 304:
            return None  # type: ignore[return-value]
        if response.headers.get("content-type", "").startswith("application/json"):
            answer_value: T = TypeAdapter(self.answer).validate_json(response.content)
            return answer_value
        return response.content  # type: ignore[return-value]


def path_of(template: str, arguments: Mapping[str, str]) -> str:
    """Fill a path template with percent-encoded arguments."""
    for name, value in arguments.items():
        template = template.replace("{" + name + "}", quote(str(value), safe=""))
    return template


def _query_text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
