"""The page's examples of requests are what its own schemas allow, and each problem that a route names is one."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from jobs.records import EVENTS
from service.http.problems import KINDS

PAGE = json.loads((Path(__file__).parents[2] / "openapi" / "openapi.json").read_text())
OPERATIONS = {
    operation["operationId"]: (path, operation) for path, item in PAGE["paths"].items() for operation in item.values()
}


def validator(schema: dict[str, Any]) -> jsonschema.Draft202012Validator:
    """References lead into the page itself."""
    return jsonschema.Draft202012Validator(
        {**schema, "components": PAGE["components"]}, format_checker=jsonschema.FormatChecker()
    )


def examples() -> Iterator[Any]:
    for name, (_, operation) in OPERATIONS.items():
        for content in operation.get("requestBody", {}).get("content", {}).values():
            for which, example in content.get("examples", {}).items():
                yield pytest.param(content["schema"], example["value"], id=f"{name}-{which}")


@pytest.mark.parametrize(("schema", "example"), list(examples()))
def test_examples_are_valid(schema: dict[str, Any], example: Any) -> None:
    validator(schema).validate(example)


def test_every_json_body_has_an_example() -> None:
    for name, (_, operation) in OPERATIONS.items():
        content = operation.get("requestBody", {}).get("content", {})
        assert "application/json" not in content or content["application/json"].get("examples"), name


@pytest.mark.parametrize("name", OPERATIONS)
def test_an_operation_is_described_completely(name: str) -> None:
    path, operation = OPERATIONS[name]
    assert operation["description"]
    assert set(operation["tags"]) <= {tag["name"] for tag in PAGE["tags"]}
    named = {code for response in operation["responses"].values() for code in problems(response)}
    assert named <= set(KINDS)
    assert {"internal-error", "bad-request"} <= named
    if path.startswith("/v1"):
        assert {"unauthorized", "forbidden", "rate-limited"} <= named
    assert {"400", "413", "500", "503"} <= operation["responses"].keys()
    for status, response in operation["responses"].items():
        assert all(KINDS[code].status == int(status) for code in problems(response))
        if status >= "400" and (path, status) != ("/readyz", "503"):
            assert list(response["content"]) == ["application/problem+json"]


def problems(response: dict[str, Any]) -> list[str]:
    return re.findall(r"`([a-z-]+)`: ", response["description"])


def test_operation_ids_are_unique_and_every_union_is_resolved() -> None:
    assert len(OPERATIONS) == sum(len(item) for item in PAGE["paths"].values())
    references = {part.split('"')[0] for part in json.dumps(PAGE).split('"$ref": "')[1:]}
    for reference in references:
        node: Any = PAGE
        for step in reference.removeprefix("#/").split("/"):
            node = node[step]
    schema = OPERATIONS["createJob"][1]["requestBody"]["content"]["application/json"]["schema"]
    assert set(schema["discriminator"]["mapping"]) == {"reconstruct", "voxelize", "diffuse", "animate"}


def test_every_event_of_a_webhook_has_its_body() -> None:
    assert set(PAGE["webhooks"]) == set(EVENTS)
    for event in PAGE["webhooks"].values():
        schema = event["post"]["requestBody"]["content"]["application/json"]["schema"]
        assert schema == {"$ref": "#/components/schemas/JobEventPayload"}


def test_a_refusal_for_now_states_when_to_come_again() -> None:
    for _, operation in OPERATIONS.values():
        for status, response in operation["responses"].items():
            assert "X-Request-Id" in response["headers"]
            assert ("Retry-After" in response["headers"]) >= (status in ("429", "503"))
