"""Typed and bounded access to fields of untrusted JSON."""

import json
import math
from collections.abc import Mapping, Sequence

from dynamictree.errors import FormatError

JsonObject = Mapping[str, object]


def parse_object(text: bytes, what: str) -> JsonObject:
    """Parse a JSON object.

    Raises:
        FormatError: it is not JSON, nested too deeply, or no object.
    """
    try:
        value: object = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"the JSON of the {what} cannot be read: {str(error)[:120]}") from error
    return as_object(value, what)


def as_object(value: object, what: str) -> JsonObject:
    """Return a value that must be a JSON object."""
    if not isinstance(value, dict):
        raise FormatError(f"{what} is {_shortened(value)}; a JSON object is allowed")
    return value


def object_field(parent: JsonObject, name: str) -> JsonObject:
    """Read an object; empty where absent."""
    return as_object(parent.get(name, {}), name)


def object_list(parent: JsonObject, name: str) -> list[JsonObject]:
    """Read a list of objects; empty where absent."""
    return [as_object(value, f"{name}[{i}]") for i, value in enumerate(_list(parent, name))]


def integer_field(parent: JsonObject, name: str, *, high: int, default: int | None = None, low: int = 0) -> int:
    """Read an integer from `low` to `high`."""
    return _integer(parent.get(name, default), name, high, low)


def index_field(parent: JsonObject, name: str, items: Sequence[object], what: str) -> int | None:
    """Read an index into a list; None where absent."""
    if name not in parent:
        return None
    if not items:
        raise FormatError(f"{name} names one of the {what}, but the file has none")
    return _integer(parent[name], f"{name} (one of the {what})", len(items) - 1)


def index_list(parent: JsonObject, name: str, items: Sequence[object]) -> list[int]:
    """Read a list of indices into a list; empty where absent."""
    return [_integer(value, name, len(items) - 1) for value in _list(parent, name)]


def number_field(parent: JsonObject, name: str, default: float | None = None) -> float:
    """Read a finite number."""
    return _number(parent.get(name, default), name)


def numbers_field(parent: JsonObject, name: str, length: int, default: Sequence[float] = ()) -> list[float]:
    """Read a list of finite numbers."""
    values = _list(parent, name) if name in parent else list(default)
    if len(values) != length:
        raise FormatError(f"{name} has {len(values)} numbers; {length} are needed")
    return [_number(value, name) for value in values]


def text_field(parent: JsonObject, name: str, default: str = "") -> str:
    """Read a string."""
    value = parent.get(name, default)
    if not isinstance(value, str):
        raise FormatError(f"{name} is {_shortened(value)}; a string is allowed")
    return value


def text_list(parent: JsonObject, name: str) -> list[str]:
    """Read a list of strings; empty where absent."""
    return [text_field({name: value}, name) for value in _list(parent, name)]


def _list(parent: JsonObject, name: str) -> list[object]:
    value = parent.get(name, [])
    if not isinstance(value, list):
        raise FormatError(f"{name} is {_shortened(value)}; a list is allowed")
    return value


def _integer(value: object, name: str, high: int, low: int = 0) -> int:
    if isinstance(value, float) and value.is_integer():  # some writers store 3 as 3.0
        value = int(value)
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise FormatError(f"{name} is {_shortened(value)}; a whole number from {low} to {high} is allowed")
    return value


def _number(value: object, name: str) -> float:
    allowed = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300
    if not allowed or not math.isfinite(value):  # type: ignore[arg-type]
        raise FormatError(f"{name} is {_shortened(value)}; a finite number is allowed")
    return float(value)  # type: ignore[arg-type]


def _shortened(value: object) -> str:
    return repr(value)[:80]
