"""Command-line options generated from the models of `dynamictree.requests`, one per field."""

import functools
import inspect
import re
from collections.abc import Callable, Iterator
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from dynamictree.errors import InputError
from dynamictree.request_model import Request, explanation

OPTION_NAMES = {
    "num_frames": "frames",
    "period_s": "period",
    "formats": "format",
    "scribbles": "scribble",
    "box_m": "box",
    "still_box_m": "still-box",
    "moving_box_m": "moving-box",
    "speed_m_s": "wind-speed",
    "direction_deg": "wind-direction",
    "azimuth_deg": "azimuth",
    "elevation_deg": "elevation",
    "damping_ratio": "damping",
    "frequency_hz": "frequency",
    "mass_kg": "mass",
    "falloff_m": "falloff",
}
"""Names of options by field, where they differ from the field's name in kebab-case."""
_SECOND_NAMES = {"preset": ("--model",)}
"""Options that may be written in two ways: a model may also be a file of weights."""
_TYPES = {"integer": int, "number": float, "boolean": bool, "string": str, "array": str}

_PLANT, _OTHER = "plant", "other"
"""Labels of a stroke."""

Schema = dict[str, Any]
Place = tuple[str, ...]
"""A field's name, after the names of the models that it is nested in."""


def with_request_options(command: Callable[..., None]) -> Callable[..., None]:
    """Replace each parameter of a command whose type is a `Request` by one option per field.

    The command receives validated models; a value that is not allowed raises an InputError that names the option.
    """
    parameters = inspect.signature(command).parameters.values()
    classes = {p.name: p.annotation for p in parameters if inspect.isclass(p.annotation)}
    models = {name: one for name, one in classes.items() if issubclass(one, Request)}
    fields = {name: dict(_fields(model.model_json_schema())) for name, model in models.items()}
    flat: list[inspect.Parameter] = []
    for parameter in parameters:
        if parameter.name in fields:
            flat += [_parameter(place[-1], schema) for place, schema in fields[parameter.name].items()]
        else:
            flat.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

    @functools.wraps(command)
    def run(**values: Any) -> None:
        for name, model in models.items():
            own = {place: (values.pop(place[-1]), schema) for place, schema in fields[name].items()}
            values[name] = _checked(model, own)
        command(**values)

    run.__signature__ = inspect.Signature(flat)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in flat}
    return run


def _fields(schema: Schema, definitions: Schema | None = None) -> Iterator[tuple[Place, Schema]]:
    """Iterate over the fields of a model with their path and JSON schema; a nested model yields its own fields."""
    definitions = schema.get("$defs", {}) if definitions is None else definitions
    for name, field in schema["properties"].items():
        if "$ref" in field:
            nested = definitions[field["$ref"].rpartition("/")[2]]
            for place, inner in _fields(nested, definitions):
                yield (name, *place), inner
        else:
            yield (name,), field


def _parameter(name: str, schema: Schema) -> inspect.Parameter:
    """Return the option of one field, as Typer reads it from a signature; rich would read a bare [m] as markup."""
    kind = _kind(schema)
    option = _option_name(name)
    declared = f"{option}/--no-{option[2:]}" if kind["type"] == "boolean" else option
    help_text = ". ".join(filter(None, (schema["description"], _allowed(kind)))).replace("[", r"\[") + "."
    default = None if kind["type"] == "array" else schema.get("default")
    python_type: Any = list[str] if "items" in kind else _TYPES[kind["type"]]
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=default,
        annotation=Annotated[
            python_type | None if default is None else python_type,
            typer.Option(declared, *_SECOND_NAMES.get(name, ()), help=help_text),
        ],
    )


def _kind(schema: Schema) -> Schema:
    """Return the JSON schema of a field without its null alternative."""
    kind: Schema = next(one for one in schema.get("anyOf", [schema]) if one["type"] != "null")
    return kind


def _allowed(kind: Schema) -> str:
    """Return the range or the choices of a field, for its help."""
    if kind["type"] == "array":
        if "items" not in kind:
            return "x,y,z,x,y,z"
        if _is_repeated(kind):
            return f"PHOTO {_PLANT}|{_OTHER} X,Y X,Y ..., once per stroke"
        choices = kind["items"].get("enum", ["names"])
        return f"Comma-separated, or the option again: {', '.join(choices)}"
    if "enum" in kind:
        *most, last = map(str, kind["enum"])
        return f"{', '.join(most)} or {last}"
    low, high = kind.get("minimum"), kind.get("maximum")
    if kind["type"] == "integer" and "exclusiveMaximum" in kind:
        high = kind["exclusiveMaximum"] - 1
    if low is not None and high is not None:
        return f"{low} to {high}" if kind["type"] == "integer" else f"{low:g} to {high:g}"
    words = {"exclusiveMinimum": "above", "minimum": "at least", "exclusiveMaximum": "below", "maximum": "at most"}
    return " and ".join(f"{word} {kind[key]:g}" for key, word in words.items() if key in kind).capitalize()


def _option_name(field: str) -> str:
    return "--" + OPTION_NAMES.get(field, field.replace("_", "-"))


def _checked(model: type[Request], values: dict[Place, tuple[Any, Schema]]) -> Request:
    """Build and validate a request model from option values."""
    filled: Schema = {}
    for (*above, name), (value, schema) in values.items():
        if value is None or value == []:
            continue
        target = filled
        for step in above:
            target = target.setdefault(step, {})
        target[name] = _read(name, value, _kind(schema))
    try:
        return model.model_validate(filled)
    except ValidationError as error:
        raise InputError(explanation(error, lambda place: _option_name(place[-1]))) from None


def _is_repeated(kind: Schema) -> bool:
    """Whether a field holds models, here strokes, one per option; not names or numbers."""
    return "$ref" in kind.get("items", {})


def _read(name: str, value: Any, kind: Schema) -> Any:
    if _is_repeated(kind):
        return [_stroke(name, text) for text in value]
    if "items" in kind:
        return [part.strip() for text in value for part in text.split(",")]
    return _box(name, value) if kind["type"] == "array" else value


def _stroke(name: str, text: str) -> Schema:
    """Parse a stroke: photo, label and places."""
    pattern = rf"(.+?)\s+({_PLANT}|{_OTHER})((?:\s+[^\s,]+,[^\s,]+)+)\s*"
    if not (parts := re.fullmatch(pattern, text)):
        problem = f'a photo, {_PLANT} or {_OTHER}, and places are needed, as "IMG_3.jpg {_PLANT} 0.5,0.4 0.5,0.7"'
        raise InputError(f"{_option_name(name)} is {text!r}: {problem}")
    photo, what, places = parts.groups()
    points = [[_number_of(value) for value in place.split(",")] for place in places.split()]
    return {"photo": photo, "plant": what == _PLANT, "points": points}


def _number_of(text: str) -> float | str:
    """Parse a number; return other text unchanged, which the model then refuses."""
    try:
        return float(text)
    except ValueError:
        return text


def _box(name: str, text: str) -> list[list[float]]:
    """Parse the six numbers of a box."""
    try:
        x0, y0, z0, x1, y1, z1 = map(float, text.split(","))
    except ValueError:
        raise InputError(
            f"{_option_name(name)} is {text!r}: six numbers are needed, x,y,z,x,y,z of the low and the high corner"
        ) from None
    return [[x0, y0, z0], [x1, y1, z1]]
