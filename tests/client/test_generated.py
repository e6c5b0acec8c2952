"""The client follows openapi.json."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import dynamictree_client
import httpx
import pytest
from dynamictree_client import operations
from dynamictree_client.errors import ProblemError, problem_of

from service.http.problems import KINDS, problem_body

ROOT = Path(__file__).parents[2]
SPEC = importlib.util.spec_from_file_location("generate", ROOT / "client" / "generate.py")
assert SPEC is not None
assert SPEC.loader is not None
generate = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(generate)


def test_every_operation_of_the_page_can_be_called() -> None:
    page = json.loads(generate.PAGE.read_text())
    methods = [
        operation for item in page["paths"].values() for operation in item.values() if "operationId" in operation
    ]
    assert len(methods) > 20
    for operation in methods:
        assert callable(getattr(operations, generate.snake(operation["operationId"]))), operation["operationId"]


@pytest.mark.parametrize("code", KINDS)
def test_every_problem_of_the_service_is_an_exception_that_holds_it(code: str) -> None:
    body = problem_body(code, "detail", request_id="r")
    response = httpx.Response(KINDS[code].status, json=body, headers={"content-type": "application/problem+json"})
    error = problem_of(response)
    assert error.code == code
    assert type(error) is not ProblemError
    assert error.problem.model_dump() == body


def test_the_public_names_are_exact() -> None:
    public = {name for name in vars(dynamictree_client) if not name.startswith("_")}
    modules = {"asynchronous", "call", "errors", "files", "retries", "synchronous", "commands"}
    assert public - modules == set(dynamictree_client.__all__)


def test_the_client_is_light() -> None:
    code = "import sys, dynamictree_client; print(*{name.split('.')[0] for name in sys.modules})"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "pydantic" in loaded
    assert {"numpy", "torch", "dynamictree", "jobs", "service", "typer"}.isdisjoint(loaded)
