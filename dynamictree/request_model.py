"""What all request parameters have in common: unknown fields are refused, and errors name field and value."""

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from dynamictree.errors import InputError

LARGEST = 1e6
"""Of any component of a vector, mass or length in a request: far beyond a storm, far below what overflows."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Box = tuple[tuple[Finite, Finite, Finite], tuple[Finite, Finite, Finite]]
"""Low and high corner [m], +Z up."""


class Request(BaseModel):
    """Root of all requests. Unknown fields are refused; in Python, wrong values raise InputError."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise InputError(explanation(error)) from None

    # tells pydantic that HTTP bodies and nested models, whose errors need their place, do not pass through __init__
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
