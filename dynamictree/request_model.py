"""Base classes of all request parameters: unknown fields are refused, and errors name field and value."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, TypeVar, get_args

from annotated_types import MaxLen
from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, ValidationError, model_validator
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from dynamictree.errors import InputError

LARGEST = 1e6
"""Largest vector component, mass or length in a request: far beyond a storm, far below an overflow."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Box = tuple[tuple[Finite, Finite, Finite], tuple[Finite, Finite, Finite]]
"""Low and high corner [m], +Z up."""


@dataclass(frozen=True)
class Pattern:
    """Annotation of a text: the pattern that it matches, and the same in words, for errors."""

    pattern: str
    allowed: str

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        """Return pydantic's schema with a check of the pattern."""
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> Any:
        """Return the JSON Schema with the pattern."""
        return handler(schema) | {"pattern": self.pattern}

    def _checked(self, text: str) -> str:
        if re.fullmatch(self.pattern, text) is None:
            raise PydanticCustomError("not_allowed", "Input should be {allowed}", {"allowed": self.allowed})
        return text


def _make_strict(schema: Any) -> None:
    if isinstance(schema, list | tuple):
        for each in schema:
            _make_strict(each)
    elif isinstance(schema, dict):
        for each in schema.values():
            _make_strict(each)
        if schema.get("type") == "int" and not schema.get("strict"):  # a nested model's schema is visited twice
            strict = schema | {"strict": True}
            schema.clear()
            schema |= core_schema.no_info_before_validator_function(_whole, strict)
        elif schema.get("type") in ("float", "bool"):
            schema["strict"] = True


def _whole(value: Any) -> Any:
    """Convert a whole float to an integer: in JSON Schema, 3.0 is the integer 3."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


MAX_UNKNOWN = 20
"""Most unknown fields that are reported one by one: errors for 90,000 fields, a body of 1 MB, take 6 s of CPU time."""


class Bounded(BaseModel):
    """Model that refuses far too many fields or items at once, before each of them is reported.

    Numbers and booleans are strict: `"1"` and `true` are refused as numbers, `"yes"` and 1 as booleans.
    """

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return pydantic's schema, made strict for numbers and booleans."""
        schema = handler(source)
        _make_strict(handler.resolve_ref_schema(schema))
        return schema

    @model_validator(mode="before")
    @classmethod
    def _not_flooded(cls, values: Any) -> Any:
        if not isinstance(values, dict):
            return values
        if len(values) > len(cls.model_fields) + MAX_UNKNOWN:
            raise ValueError(f"{len(values):,} fields were sent; {len(cls.model_fields)} are known")
        for name, most in _longest(cls).items():
            if isinstance(given := values.get(name), list | tuple | dict) and len(given) > most:
                raise ValueError(f"{name} has {len(given):,} items; at most {most:,} are allowed")
        return values


@cache
def _longest(model: type[BaseModel]) -> dict[str, int]:
    """Return the largest number of items of each field that declares one."""
    longest = {}
    for name, field in model.model_fields.items():
        inner = [each for choice in get_args(field.annotation) for each in getattr(choice, "__metadata__", ())]
        constraints = [*field.metadata, *(more for each in inner for more in getattr(each, "metadata", ()))]
        for each in constraints:
            if isinstance(each, MaxLen):
                longest[name] = each.max_length
    return longest


class Request(Bounded):
    """Root of all requests. Unknown fields are refused; in Python, wrong values raise InputError."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def __init__(self, **values: Any) -> None:
        try:  # not strict: callers in Python may pass any number, such as numpy's
            self.__pydantic_validator__.validate_python(values, self_instance=self, strict=False)
        except ValidationError as error:
            raise InputError(explanation(error)) from None

    # pydantic then builds HTTP bodies and nested models without __init__, so that their errors keep their location
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def part_of(cls: type["Part"], params: Mapping[str, object]) -> "Part":
        """Read the fields of this model from the parameters of a larger request; defaults where they are missing."""
        return cls.model_validate({name: params[name] for name in cls.model_fields if name in params})


Part = TypeVar("Part", bound=Request)


def explanation(error: ValidationError, name_of: Callable[[Sequence[str]], str] = ".".join) -> str:
    """Name every wrong field, the value found and the values allowed, in one line."""
    lines: dict[str, str] = {}  # the first error of each field; later ones follow from it
    for one in error.errors(include_url=False):
        steps = [step for step in one["loc"] if isinstance(step, str)]
        name = name_of(steps) if steps else ""
        allowed = one["msg"].removeprefix("Value error, ").replace("Input should", "it should")
        if one["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
            lines.setdefault(name, f"there is no parameter {name}")
        else:
            lines.setdefault(name, f"{name} is {one['input']!r}: {allowed}" if name else allowed)
    return "; ".join(lines.values())
