"""Generate the client from openapi.json: `models.py`, `operations.py`, and `synchronous.py` from `asynchronous.py`.

`python client/generate.py --write` rewrites them, `--check` tells which are not as they would be written.
"""

import argparse
import json
import re
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
PACKAGE = FOLDER / "dynamictree_client"
PAGE = FOLDER.parent / "openapi" / "openapi.json"
HEAD = '"""{what} Made by client/generate.py; do not edit."""\n\n'

Schema = dict[str, Any]
_LEAST_SHARED = 5  # least number of fields; fewer, as a name and a size, can be equal by chance
_PLAIN = {"string": "str", "integer": "int", "number": "float", "boolean": "bool", "null": "None"}

# one token of the asynchronous client per line, and its equivalent in the blocking one
_SYNCHRONOUS = [
    (r"\bAsyncClient\b", "Client"),
    (r"\bAsyncIterator\b", "Iterator"),
    (r"\basync (def|with|for) ", r"\1 "),
    (r"\bawait ", ""),
    (r"\b__a(enter|exit)__\b", r"__\1__"),
    (r"\baclose\b", "close"),
    (r"\ba(iter_raw|iter_bytes|iter_lines|read)\b", r"\1"),
    (r"\bAsyncBaseTransport\b", "BaseTransport"),
    (r"\basynccontextmanager\b", "contextmanager"),
    (r"\basyncio\.sleep\b", "time.sleep"),
    (r"^import asyncio$", "import time"),
    (r"\basynchronous\b", "blocking"),
]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    choice = parser.add_mutually_exclusive_group(required=True)
    choice.add_argument("--write", action="store_true")
    choice.add_argument("--check", action="store_true")
    chosen = parser.parse_args(arguments)
    stale = [path for path, text in generated().items() if not path.exists() or path.read_text() != text]
    if chosen.write:
        for path in stale:
            path.write_text(generated()[path])
        return 0
    for path in stale:
        print(f"{path} is not what openapi.json and asynchronous.py make of it: run make openapi", file=sys.stderr)
    return 1 if stale else 0


def generated() -> dict[Path, str]:
    """Return every generated file with its content."""
    page = json.loads(PAGE.read_text())
    modules = {
        "models.py": models(page["components"]["schemas"]),
        "operations.py": operations(page),
        "synchronous.py": synchronous((PACKAGE / "asynchronous.py").read_text()),
    }
    return {PACKAGE / name: formatted(text, name) for name, text in modules.items()}


def formatted(text: str, name: str) -> str:
    ruff = [sys.executable, "-m", "ruff"]
    at = str(PACKAGE / name)
    sorted_text = _piped([*ruff, "check", "-q", "--select", "I,F401", "--fix-only", "--stdin-filename", at, "-"], text)
    return _piped([*ruff, "format", "-q", "--stdin-filename", at, "-"], sorted_text)


def _piped(command: list[str], text: str) -> str:
    return subprocess.run(command, input=text, capture_output=True, text=True, check=True).stdout


def class_name(name: str) -> str:
    return name.removesuffix("Payload")


def models(schemas: dict[str, Schema]) -> str:
    lines = [HEAD.format(what="Models of requests and responses."), "from datetime import datetime\n"]
    lines += ["from typing import Any, Literal\n\nfrom pydantic import BaseModel, ConfigDict\n\n\n"]
    lines += [
        'class Model(BaseModel):\n    """Root of all. What a newer service adds is passed over."""\n\n'
        '    model_config = ConfigDict(frozen=True, extra="ignore", defer_build=True)\n\n\n'
    ]
    for name, schema in schemas.items():
        if schema.get("type") != "object":
            lines.append(
                f"{class_name(name)} = {python_type(schema)}\n{_quoted(schema.get('description', name))}\n\n\n"
            )
    objects = {name: schema for name, schema in schemas.items() if schema.get("type") == "object"}
    for name in sorted(objects, key=lambda name: len(_ancestors(name, objects))):
        lines += _model(name, objects)
    return "".join(lines)


def _ancestors(name: str, objects: dict[str, Schema]) -> list[str]:
    """Return models whose fields are all in this one, as in the service's own classes; the largest first."""
    own = _fields(objects[name])
    some = [other for other, schema in objects.items() if _LEAST_SHARED <= len(_fields(schema)) < len(own)]
    return sorted(
        (other for other in some if _fields(objects[other]).items() <= own.items()),
        key=lambda other: -len(_fields(objects[other])),
    )


def _fields(schema: Schema) -> dict[str, str]:
    """Return each field's schema as text, by name."""
    required = schema.get("required", [])
    return {name: f"{name in required} {json.dumps(kind)}" for name, kind in schema.get("properties", {}).items()}


def _model(name: str, objects: dict[str, Schema]) -> list[str]:
    schema, base = objects[name], next(iter(_ancestors(name, objects)), None)
    parent = "Model" if base is None else class_name(base)
    lines = [f"class {class_name(name)}({parent}):\n    {_quoted(schema.get('description', name))}\n\n"]
    if schema.get("additionalProperties") is True:
        lines.append('    model_config = ConfigDict(frozen=True, extra="allow", defer_build=True)\n\n')
    for field, kind in schema.get("properties", {}).items():
        if base is not None and field in objects[base]["properties"]:
            continue
        optional = field not in schema.get("required", [])
        default = f" = {_default(kind)}" if optional else ""
        lines += [f"    # {line}\n" for line in textwrap.wrap(kind.get("description", ""), 110)]
        lines.append(f"    {field}: {field_type(kind, optional=optional)}{default}\n")
    return [*lines, "\n\n"]


def _default(schema: Schema) -> str:
    """Return the service's default value as source code."""
    default = schema.get("default")
    if isinstance(default, list):
        return repr(default)  # pydantic copies it
    return "None" if isinstance(default, dict) else repr(default)


def _quoted(text: str) -> str:
    first, *rest = textwrap.wrap(text, 110)
    return "\n    ".join([f'"""{first}', *rest, '"""']) if rest else f'"""{first}"""'


def field_type(schema: Schema, *, optional: bool) -> str:
    """Return the annotation, quoted if it names a class that may be defined later; optional without a default: None."""
    annotation = python_type(schema)
    if optional and not isinstance(schema.get("default"), str | int | float | list) and "None" not in annotation:
        annotation = f"{annotation} | None"
    names_a_class = re.search(r"\b[A-Z]\w+", re.sub(r"Literal\[[^]]*\]|\bAny\b|\bNone\b", "", annotation))
    return f'"{annotation}"' if names_a_class else annotation


def python_type(schema: Schema) -> str:
    if "$ref" in schema:
        return class_name(schema["$ref"].rsplit("/", 1)[1])
    if "const" in schema:
        return f"Literal[{schema['const']!r}]"
    if "enum" in schema:
        return f"Literal[{', '.join(map(repr, schema['enum']))}]"
    for union in ("anyOf", "oneOf"):
        if union in schema:
            return " | ".join(dict.fromkeys(map(python_type, schema[union])))
    if "allOf" in schema and len(schema["allOf"]) == 1:
        return python_type(schema["allOf"][0])
    kind = schema.get("type")
    if kind == "array" and "prefixItems" in schema:
        return f"tuple[{', '.join(map(python_type, schema['prefixItems']))}]"
    if kind == "array":
        return f"list[{python_type(schema.get('items', {}))}]"
    if kind == "object":
        more = schema.get("additionalProperties")
        return f"dict[str, {python_type(more) if isinstance(more, dict) and more else 'Any'}]"
    if kind == "string" and schema.get("format") == "date-time":
        return "datetime"
    if kind == "string" and (schema.get("format") == "binary" or "contentMediaType" in schema):
        return "bytes"
    return _PLAIN.get(str(kind), "Any")


def operations(page: Schema) -> str:
    lines = [HEAD.format(what="One function per operation: its request, and the type of its response.")]
    lines += ["from datetime import datetime\nfrom typing import Any, Literal\n\n"]
    lines += ["from dynamictree_client.call import Call, path_of\n"]
    names = sorted({class_name(name) for name in page["components"]["schemas"]})
    lines += [f"from dynamictree_client.models import ({', '.join(names)})\n\n\n"]
    for path, item in page["paths"].items():
        for method, operation in item.items():
            if method in ("get", "head", "post", "put", "patch", "delete", "options"):
                lines += _operation(path, method, item.get("parameters", []), operation)
    return "".join(lines)


def _operation(path: str, method: str, shared: list[Schema], operation: Schema) -> list[str]:
    parameters = [*shared, *operation.get("parameters", [])]
    body = operation.get("requestBody", {}).get("content", {}).get("application/json")
    raw = None if body else next(iter(operation.get("requestBody", {}).get("content", {})), None)
    needed, options, places = list[str](), list[str](), dict[str, list[str]]({"path": [], "query": [], "header": []})
    for parameter in parameters:
        if parameter["in"] not in places:
            continue
        argument = snake(parameter["name"])
        kind = python_type(parameter.get("schema", {}))
        if parameter.get("required"):
            (needed if parameter["in"] == "path" else options).append(f"{argument}: {kind}")
        else:
            options.append(f"{argument}: {kind.removesuffix(' | None')} | None = None")
        places[parameter["in"]].append(f"{parameter['name']!r}: {argument}")
    sent = ""
    if body:
        optional = not operation["requestBody"].get("required")
        kind = python_type(body["schema"]).removesuffix(" | None")
        needed.append(f"body: {kind} | None = None" if optional else f"body: {kind}")
        sent = ", body=body"
    elif raw:
        needed.append("content: bytes")
        sent = f", content=content, content_type={raw!r}"
    answer = _answer(operation["responses"])
    signature = ", ".join([*needed, *(["*", *options] if options else [])])
    at = f"path_of({path!r}, {{{', '.join(places['path'])}}})" if places["path"] else repr(path)
    more = "".join(
        f", {to}={{{', '.join(places[of])}}}" for of, to in (("query", "query"), ("header", "headers")) if places[of]
    )
    annotation = operation.get("description") or operation.get("summary", "")
    return [
        f"def {snake(operation['operationId'])}({signature}) -> Call[{answer}]:\n    {_quoted(annotation)}\n",
        f"    return Call(method={method.upper()!r}, path={at}, answer={answer}{more}{sent})\n\n\n",
    ]


def _answer(responses: dict[str, Schema]) -> str:
    """Return the type of a success: models for JSON, else bytes, else None."""
    good = [response for status, response in responses.items() if status.startswith("2")]
    content = [pair for response in good for pair in response.get("content", {}).items()]
    kinds = [python_type(entry.get("schema", {})) for media, entry in content if media == "application/json"]
    if any(media != "application/json" for media, _ in content):
        kinds.append("bytes")
    return " | ".join(dict.fromkeys(kinds)) or "None"


def snake(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).replace("-", "_").lower()


def synchronous(source: str) -> str:
    """Convert the asynchronous client's source to the blocking client's."""
    _, _, rest = source.partition('"""\n')  # its docstring is one line
    for pattern, other in _SYNCHRONOUS:
        rest = re.sub(pattern, other, rest, flags=re.MULTILINE)
    return HEAD.format(what="The blocking client.") + rest.lstrip("\n")


if __name__ == "__main__":
    raise SystemExit(main())
