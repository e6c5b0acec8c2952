"""docker-compose.yml: what must hold of every container. There is no engine here to ask."""

import json
import re
import runpy
import stat
from importlib import resources
from pathlib import Path

import pytest
import yaml
from jsonschema import Draft7Validator
from sqlalchemy.engine import make_url

from jobs.settings import Settings
from jobs.states import queues_of

ROOT = Path(__file__).parents[2]
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
SERVICES = COMPOSE["services"]


@pytest.mark.parametrize("name", SERVICES)
def test_a_container_is_confined(name: str) -> None:
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["user"].split(":")[0] not in {"0", "root"}
    assert service["cap_drop"] == ["ALL"]
    assert "no-new-privileges:true" in service["security_opt"]
    assert service["healthcheck"]["test"][0] in {"CMD", "CMD-SHELL"}
    assert set(service["deploy"]["resources"]["limits"]) == {"cpus", "memory"}
    tag = service["image"].rpartition(":")[2]
    assert tag.removeprefix("RELEASE.")[0].isdigit(), f"{service['image']} is pinned to no version"


def test_what_is_used_is_declared() -> None:
    assert {name.split(":")[0] for s in SERVICES.values() for name in s.get("volumes", ())} == set(COMPOSE["volumes"])
    assert {name for s in SERVICES.values() for name in s.get("secrets", ())} == set(COMPOSE["secrets"])
    assert {name for s in SERVICES.values() for name in s.get("depends_on", ())} <= set(SERVICES)
    assert all(Path(ROOT / s["build"]["dockerfile"]).is_file() for s in SERVICES.values() if "build" in s)


def test_every_variable_is_a_setting() -> None:
    names = {name for s in SERVICES.values() for name in s.get("environment", ()) if name.startswith("DYNAMICTREE_")}
    assert names
    assert names <= {f"DYNAMICTREE_{field.upper()}" for field in Settings.model_fields}


def test_no_secret_is_written_down() -> None:
    for service in SERVICES.values():
        for name, value in service.get("environment", {}).items():
            if "PASSWORD" in name or "SECRET" in name or "KEY" in name or "DATABASE" in name:
                assert name.endswith("_FILE") or str(value).startswith("${"), name


def test_redis_keeps_everything() -> None:
    command = SERVICES["redis"]["command"]
    assert command[command.index("--appendonly") + 1] == "yes"
    assert command[command.index("--maxmemory-policy") + 1] == "noeviction"


def test_only_the_api_is_reachable_and_only_from_this_machine() -> None:
    assert {name: s["ports"] for name, s in SERVICES.items() if "ports" in s} == {"api": ["127.0.0.1:8000:8000"]}


def test_a_worker_runs_one_job_at_a_time() -> None:
    command = SERVICES["worker"]["command"]
    assert command[command.index("-c") + 1] == "1"


def test_secrets_are_made_once(tmp_path: Path) -> None:
    made = runpy.run_path(str(ROOT / "docker" / "make_secrets.py"))["main"]
    made(tmp_path / "secrets")
    before = {path.name: path.read_text() for path in (tmp_path / "secrets").iterdir()}
    assert set(before) == set(COMPOSE["secrets"])
    assert stat.S_IMODE((tmp_path / "secrets").stat().st_mode) == 0o700
    assert make_url(before["dynamictree_database_url"]).password == before["postgres_password"]
    made(tmp_path / "secrets")
    assert {path.name: path.read_text() for path in (tmp_path / "secrets").iterdir()} == before


def test_the_file_is_what_compose_expects() -> None:
    """The published schema of compose files, as check-jsonschema carries it."""
    schema = resources.files("check_jsonschema") / "builtin_schemas" / "vendor" / "compose-spec.json"
    Draft7Validator(json.loads(schema.read_text())).validate(COMPOSE)


def test_images_are_built_from_what_is_pinned() -> None:
    text = (ROOT / "docker" / "Dockerfile").read_text()
    assert "requirements.lock" in text
    assert re.search(r"uv==[0-9.]+", text)
    assert not re.search(r"^FROM [^$\n]*:latest", text, re.MULTILINE)
    assert re.search(r"^ARG PYTHON=3\.11\.[0-9]+-slim-bookworm$", text, re.MULTILINE)


def test_whoever_waits_for_object_storage_has_its_key_as_a_file() -> None:
    for name in ("api", "worker", "worker-gpu", "housekeeper", "objects"):
        assert {"dynamictree_s3_access_key_id", "dynamictree_s3_secret_access_key"} <= set(SERVICES[name]["secrets"])


@pytest.mark.parametrize("queue", ["cpu", "gpu"])
def test_a_worker_listens_to_every_priority(queue: str) -> None:
    command = SERVICES["worker" if queue == "cpu" else "worker-gpu"]["command"]
    assert command[command.index("-Q") + 1] == ",".join(queues_of(queue))


def test_the_gpu_is_asked_for_by_profile() -> None:
    assert {name for name, service in SERVICES.items() if "profiles" in service} == {"worker-gpu"}
    [device] = SERVICES["worker-gpu"]["deploy"]["resources"]["reservations"]["devices"]
    assert device["capabilities"] == ["gpu"]
