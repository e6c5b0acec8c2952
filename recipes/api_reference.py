"""Generate the HTTP reference from openapi.json: `python -m recipes.api_reference docs/api.md`."""

import json
import sys
from pathlib import Path
from typing import Any

PAGE = Path(__file__).parent.parent / "openapi" / "openapi.json"
Schema = dict[str, Any]


def main() -> None:
    Path(sys.argv[1]).write_text(reference_page(json.loads(PAGE.read_text())))


def reference_page(page: Schema) -> str:
    """Return the reference as Markdown: operations by tag, then the fields of bodies."""
    lines = ["# HTTP reference", "", page["info"]["description"], ""]
    lines += ["Made of [`/openapi.json`](https://spec.openapis.org/oas/v3.1.1.html), which every service serves.", ""]
    for tag in page["tags"]:
        lines += [f"## {tag['name']}", "", tag["description"], ""]
        for path, item in page["paths"].items():
            for method, operation in item.items():
                if operation["tags"][0] == tag["name"]:
                    lines += _operation(page, method, path, operation)
    lines += ["## Bodies", ""]
    for name, schema in page["components"]["schemas"].items():
        lines += [f"### {name}", "", schema.get("description", ""), ""]
        if "enum" in schema:
            lines += [_type(schema), ""]
        lines += _fields(schema)
    return "\n".join(lines) + "\n"


def _operation(page: Schema, method: str, path: str, operation: Schema) -> list[str]:
    lines = [f"### {operation['operationId']}", "", f"`{method.upper()} {path}`", "", operation["description"], ""]
    rows = [
        f"| `{parameter['name']}` | {parameter['in']} | {_type(parameter['schema'])} | {_cell(parameter)} |"
        for parameter in operation.get("parameters", [])
    ]
    if rows:
        lines += ["| parameter | in | type | |", "|---|---|---|---|", *rows, ""]
    for media, content in operation.get("requestBody", {}).get("content", {}).items():
        lines += [f"Body, `{media}`: {_type(content['schema'])}", ""]
        for example in list(content.get("examples", {}).values())[:1]:
            lines += ["```json", json.dumps(example["value"], indent=1), "```", ""]
    for status, response in operation["responses"].items():
        if status < "400":
            kinds = [f"`{media}` {_type(content['schema'])}" for media, content in response.get("content", {}).items()]
            lines += [f"**{status}** {response['description']}" + (f": {', '.join(kinds)}" if kinds else ""), ""]
    codes = [
        code for status, response in operation["responses"].items() if status >= "400" for code in _codes(response)
    ]
    links = [f"[{code}](troubleshooting.md#{code})" for code in codes]
    return [*lines, f"Problems: {', '.join(links)}", ""]


def _codes(response: Schema) -> list[str]:
    content = response.get("content", {}).get("application/problem+json", {})
    return [example["$ref"].rsplit("/", 1)[1] for example in content.get("examples", {}).values()]


def _fields(schema: Schema) -> list[str]:
    rows = [
        f"| `{name}`{'' if name in schema.get('required', []) else ' ?'} | {_type(field)} | {_cell(field)} |"
        for name, field in schema.get("properties", {}).items()
    ]
    return ["| field | type | |", "|---|---|---|", *rows, ""] if rows else []


def _cell(described: Schema) -> str:
    """Format description, range and default as one table cell."""
    schema = described.get("schema", described)
    parts = [described.get("description", "")]
    for word, name in (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<")):
        if word in schema:
            parts.append(f"{name} {schema[word]:g}")
    if schema.get("default") is not None:
        parts.append(f"default `{json.dumps(schema['default'])}`")
    return "; ".join(part for part in parts if part).replace("|", "\\|").replace("\n", " ")


def _type(schema: Schema) -> str:
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[1]
        return f"[{name}](#{name.lower()})"
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    if "enum" in schema:
        return " \\| ".join(f"`{value}`" for value in schema["enum"])
    for union in ("anyOf", "oneOf"):
        if union in schema:
            return " or ".join(dict.fromkeys(_type(branch) for branch in schema[union]))
    kind = str(schema.get("type", "any"))
    if kind == "array":
        return f"list of {_type(schema.get('items', {}))}"
    return f"{kind}, {schema['format']}" if "format" in schema else kind


if __name__ == "__main__":
    main()
