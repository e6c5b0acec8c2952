import json
from pathlib import Path
from typing import Any

from openapi_spec_validator import validate

COMMITTED = Path(__file__).parents[2] / "openapi" / "openapi.json"


def test_the_page_is_valid_openapi() -> None:
    validate(json.loads(COMMITTED.read_text()))


def test_every_route_is_versioned_or_at_the_root() -> None:
    paths = json.loads(COMMITTED.read_text())["paths"]
    assert {path for path in paths if not path.startswith("/v1/")} == {"/livez", "/readyz", "/metrics"}


def test_every_list_of_a_body_is_bounded() -> None:
    """Each wrong item of a list is an error of its own: 200,000 of them take 10 s of a processor."""
    page = json.loads(COMMITTED.read_text())
    schemas = page["components"]["schemas"]
    bodies = [
        content["schema"]
        for item in page["paths"].values()
        for operation in item.values()
        for content in operation.get("requestBody", {}).get("content", {}).values()
    ]
    waiting, seen = list[Any](bodies), set[str]()
    while waiting:
        node = waiting.pop()
        if isinstance(node, list):
            waiting += node
        elif isinstance(node, dict):
            assert node.get("type") != "array" or "maxItems" in node, node
            name = str(node.get("$ref", "")).rpartition("/")[2]
            if name and name not in seen:
                seen.add(name)
                waiting.append(schemas[name])
            waiting += node.values()
    assert len(seen) >= 19
