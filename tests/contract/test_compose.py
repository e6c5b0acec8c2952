"""docker-compose.yml: what must hold of every container. `make compose` runs it on an engine."""

import json
import re
import runpy
import stat
import tomllib
from importlib import metadata, resources
from pathlib import Path

import pytest
import yaml
from jsonschema import Draft7Validator
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from sqlalchemy.engine import make_url

from jobs.settings import GIB, Settings
from jobs.states import queues_of

ROOT = Path(__file__).parents[2]
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
SERVICES = COMPOSE["services"]


@pytest.mark.parametrize("name", SERVICES)
def test_a_container_is_confined_and_may_start_slowly(name: str) -> None:
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["user"].split(":")[0] not in {"0", "root"}
    assert service["cap_drop"] == ["ALL"]
    assert "no-new-privileges:true" in service["security_opt"]
    assert service["healthcheck"]["test"][0] in {"CMD", "CMD-SHELL"}
    assert set(service["deploy"]["resources"]["limits"]) == {"cpus", "memory"}
    # an API needed 97 s on a loaded machine; `up --wait` gives up on a container that is once unhealthy
    assert int(service["healthcheck"]["start_period"].removesuffix("s")) >= (60 if name == "redis" else 120)
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


def test_only_the_api_is_reachable_and_only_from_this_machine() -> None:
    assert {name: s["ports"] for name, s in SERVICES.items() if "ports" in s} == {
        "api": ["127.0.0.1:${PORT:-8000}:8000", "127.0.0.1:${OPS_PORT:-9100}:9100"]
    }


def test_secrets_are_made_once(tmp_path: Path) -> None:
    make_secrets = runpy.run_path(str(ROOT / "docker" / "make_secrets.py"))["main"]
    make_secrets(tmp_path / "secrets")
    before = {path.name: path.read_text() for path in (tmp_path / "secrets").iterdir()}
    assert set(before) == {Path(secret["file"]).name for secret in COMPOSE["secrets"].values()}
    assert stat.S_IMODE((tmp_path / "secrets").stat().st_mode) == 0o700
    assert make_url(before["dynamictree_database_url"]).password == before["postgres_password"]
    [identity] = json.loads(before["seaweedfs_s3.json"])["identities"]
    names = {"accessKey": "dynamictree_s3_access_key_id", "secretKey": "dynamictree_s3_secret_access_key"}
    assert identity["credentials"] == [{key: before[name] for key, name in names.items()}]
    make_secrets(tmp_path / "secrets")
    assert {path.name: path.read_text() for path in (tmp_path / "secrets").iterdir()} == before


def test_the_file_is_what_compose_expects() -> None:
    """The published schema of compose files, as check-jsonschema carries it."""
    schema = resources.files("check_jsonschema") / "builtin_schemas" / "vendor" / "compose-spec.json"
    Draft7Validator(json.loads(schema.read_text())).validate(COMPOSE)


def test_images_are_built_from_what_is_pinned() -> None:
    text = (ROOT / "docker" / "Dockerfile").read_text()
    assert "--require-hashes" in text
    assert re.search(r"uv==[0-9.]+", text)
    assert not re.search(r"^FROM [^$\n]*:latest", text, re.MULTILINE)
    assert re.search(r"^ARG PYTHON=3\.11\.[0-9]+-slim-bookworm$", text, re.MULTILINE)


def test_object_storage_shows_nothing_but_s3_to_whom_has_its_key_as_a_file() -> None:
    for name in ("api", "worker", "worker-gpu", "housekeeper"):
        assert {"dynamictree_s3_access_key_id", "dynamictree_s3_secret_access_key"} <= set(SERVICES[name]["secrets"])
    assert SERVICES["objects"]["secrets"] == ["seaweedfs_s3"]
    options = {"-ip.bind=127.0.0.1", "-s3.ip.bind=0.0.0.0", "-master.telemetry=false"}
    assert options <= set(SERVICES["objects"]["command"])


def test_parsers_fit_into_the_memory_of_the_api() -> None:
    api = SERVICES["api"]
    parsers = int(api["environment"]["DYNAMICTREE_PARSER_MEMORY_BYTES"]) * Settings.model_fields["max_parsers"].default
    scratch, own = 1 * GIB, 1 * GIB  # memory of /tmp; memory of the API itself
    limit = int(api["deploy"]["resources"]["limits"]["memory"].removesuffix("g")) * GIB
    assert parsers + scratch + own <= limit


def test_the_image_has_what_runs_in_it_and_nothing_else() -> None:
    """Every file is checked by its hash but torch's, whose hash depends on the backend; versions are the tests' own."""
    text = (ROOT / "docker" / "requirements.lock").read_text()
    locked = re.findall(r"^([a-z0-9-]+)==([^ \n]+)", text, re.MULTILINE)
    versions = re.findall(r"^([a-z0-9-]+)==([^ \n]+)", (ROOT / "requirements.lock").read_text(), re.MULTILINE)
    assert set(locked) <= set(versions)
    assert text.count("--hash=sha256:") >= len(locked)
    assert not {"mypy", "pytest", "playwright", "swift", "ruff", "torch", "transformers"} & dict(locked).keys()
    assert (ROOT / "docker" / "requirements-torch.lock").read_text().strip() == f"torch=={dict(versions)['torch']}"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = ("photos", "postgres", "usd", "video")
    needed = project["dependencies"] + [name for extra in extras for name in project["optional-dependencies"][extra]]
    names = {re.split(r"[\[<>=]", line)[0].lower() for line in needed}
    assert names - {"torch"} <= dict(locked).keys(), "run `make lock`"
    installed = {canonicalize_name(one.name): one for one in metadata.distributions()}
    lines = [line for name in dict(locked).keys() & installed.keys() for line in installed[name].requires or ()]
    needs = [one for one in map(Requirement, lines) if one.marker is None or one.marker.evaluate({"extra": ""})]
    assert {canonicalize_name(one.name) for one in needs} - {"torch"} <= dict(locked).keys(), "run `make lock-image`"


@pytest.mark.parametrize("queue", ["cpu", "gpu"])
def test_a_worker_runs_one_job_at_a_time_of_every_priority(queue: str) -> None:
    command = SERVICES["worker" if queue == "cpu" else "worker-gpu"]["command"]
    assert command[command.index("-c") + 1] == "1"
    assert command[command.index("-Q") + 1] == ",".join(queues_of(queue))
