"""Translate pydantic's validation errors into field errors that name the value and what is allowed."""

from collections.abc import Mapping, Sequence
from typing import Any

from jobs.states import JOB_TYPES
from service.http.problems import FieldError, ProblemError

MAX_VALUE_CHARS = 60
MAX_ERRORS = 20
MAX_SEEN = 200
"""Number of a body's errors that are examined."""
MAX_POINTER = 200


def field_errors(raw_errors: Sequence[Mapping[str, Any]]) -> list[FieldError]:
    """Return the first invalid fields of `ValidationError.errors()` or FastAPI's errors."""
    left = max(len(raw_errors) - MAX_SEEN, 0)
    raw_errors = raw_errors[:MAX_SEEN]
    # a list that only its invalid members make too short is no error of its own
    above = {tuple(error["loc"][:end]) for error in raw_errors for end in range(len(error["loc"]))}
    raw_errors = [error for error in raw_errors if error["type"] != "too_short" or tuple(error["loc"]) not in above]
    errors: list[FieldError] = [
        {"pointer": _pointer(error), "code": error["type"].replace("_", "-"), "detail": _detail(error)}
        for error in raw_errors[:MAX_ERRORS]
    ]
    if (more := len(raw_errors) + left - MAX_ERRORS) > 0:
        errors.append({"pointer": "", "code": "more", "detail": f"{more} more fields are wrong"})
    return errors


def invalid_fields(raw_errors: Sequence[Mapping[str, Any]], where: str | None = None) -> ProblemError:
    """Return the problem of invalid fields; `where` is their location if pydantic does not report it."""
    if where is not None:
        raw_errors = [{**error, "loc": (where, *error["loc"])} for error in raw_errors]
    errors = field_errors(raw_errors)
    detail = "; ".join(f"{error['pointer'] or 'the body'}: {error['detail']}" for error in errors)
    return ProblemError("validation-failed", detail, errors=errors)


def _pointer(error: Mapping[str, Any]) -> str:
    """JSON pointer (RFC 6901) into the body, or where:name."""
    where, *steps = error["loc"]
    if where != "body":
        return f"{where}:{steps[-1]}"[:MAX_POINTER]
    if steps and (steps[0] in JOB_TYPES or isinstance(steps[0], int)):
        steps = steps[1:]  # the union's branch, or a position in broken JSON: not a step in the body
    if error["type"].startswith("union_tag"):
        steps = [*steps, error["ctx"]["discriminator"].strip("'")]
    return "".join("/" + str(step).replace("~", "~0").replace("/", "~1") for step in steps)[:MAX_POINTER]


def _detail(error: Mapping[str, Any]) -> str:
    message, given, more = str(error["msg"]), error.get("input"), error.get("ctx", {})
    match error["type"]:
        case "json_invalid":
            return f"this is no JSON: {more['error']} at character {error['loc'][-1]}"
        case "missing" | "union_tag_not_found":
            return "this is needed, and was not sent"
        case "extra_forbidden" | "unexpected_keyword_argument":
            return "there is no such field; /openapi.json tells those that there are"
        case "union_tag_invalid":
            return f"{_truncated(more['tag'])} was sent; {more['expected_tags']} are allowed"
        case "dataclass_type":
            message = "Input should be an object"
        case "value_error":
            return message.removeprefix("Value error, ")
        case "model_attributes_type" if isinstance(given, bytes | str):
            return "this is no JSON object; send one, with Content-Type: application/json"
    plain = isinstance(given, str | int | float | None)
    return f"{message}; {_truncated(given)} was sent" if plain else message


def _truncated(value: object) -> str:
    text = repr(value)
    return text if len(text) <= MAX_VALUE_CHARS else text[:MAX_VALUE_CHARS] + "…"
