"""deploy/kubernetes: every object against Kubernetes' own schema, and against what docker-compose.yml says."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import kubernetes_validate
import pytest
import yaml

from jobs.lifecycle.statistics import Census, QueueLength
from jobs.settings import GIB, Settings
from jobs.states import queues_of
from service.routes.metrics import store_gauges

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "deploy" / "kubernetes"
KUSTOMIZATION = yaml.safe_load((FOLDER / "kustomization.yaml").read_text())
OBJECTS = [
    manifest for name in KUSTOMIZATION["resources"] for manifest in yaml.safe_load_all((FOLDER / name).read_text())
]
GPU = yaml.safe_load((FOLDER / "gpu" / "scaling.yaml").read_text())
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]
SERVED = "1.31"


def _named(kind: str, name: str) -> Any:
    [manifest] = [o for o in OBJECTS if o["kind"] == kind and o["metadata"]["name"] == name]
    return manifest


def _container(name: str) -> Any:
    [container] = _named("Deployment", name)["spec"]["template"]["spec"]["containers"]
    return container


def test_every_file_is_a_resource() -> None:
    assert {path.name for path in FOLDER.glob("*.yaml")} == {*KUSTOMIZATION["resources"], "kustomization.yaml"}


@pytest.mark.parametrize("manifest", [o for o in OBJECTS if "keda" not in o["apiVersion"]], ids=lambda o: o["kind"])
def test_an_object_is_what_kubernetes_expects(manifest: Any) -> None:
    kubernetes_validate.validate(manifest, SERVED, strict=True)


@pytest.mark.parametrize("name", ["api", "worker", "worker-gpu", "housekeeper"])
def test_a_pod_is_restricted_and_noticed_where_it_hangs(name: str) -> None:
    pod, container = _named("Deployment", name)["spec"]["template"]["spec"], _container(name)
    assert pod["securityContext"]["runAsNonRoot"] is True
    assert pod["automountServiceAccountToken"] is False
    assert container["securityContext"]["readOnlyRootFilesystem"] is True
    assert container["securityContext"]["capabilities"] == {"drop": ["ALL"]}
    assert set(container["resources"]["limits"]) - {"nvidia.com/gpu"} == {"cpu", "memory"}
    assert "livenessProbe" in container
    assert container.get("args", []) == COMPOSE[name].get("command", [])


def test_variables_are_settings_of_the_service() -> None:
    named = set(_named("ConfigMap", "settings")["data"]) | {v["name"] for v in _container("worker")["env"]}
    ours = {name for name in named if name.startswith("DYNAMICTREE_")}
    assert ours <= {f"DYNAMICTREE_{field.upper()}" for field in Settings.model_fields}


@pytest.mark.parametrize(("scaled", "base"), [(_named("ScaledObject", "worker"), "cpu"), (GPU, "gpu")], ids=str)
def test_workers_follow_the_number_of_unfinished_jobs(scaled: Any, base: str) -> None:
    spec = scaled["spec"]
    deployment = _named("Deployment", spec["scaleTargetRef"]["name"])
    assert ",".join(queues_of(base)) in deployment["spec"]["template"]["spec"]["containers"][0]["args"]
    assert deployment["spec"].get("replicas", 0) == 0  # two masters would undo one another
    assert spec["minReplicaCount"] == 1
    keys = {"scaleTargetRef", "minReplicaCount", "maxReplicaCount", "pollingInterval", "cooldownPeriod", "advanced"}
    assert set(spec) == keys | {"triggers", "fallback"}
    modifiers = spec["advanced"]["scalingModifiers"]
    assert modifiers["metricType"] == "AverageValue"
    counted = {trigger["name"]: _value_of(trigger, dict.fromkeys(queues_of(base), 2)) for trigger in spec["triggers"]}
    assert sum(counted[name] for name in modifiers["formula"].split(" + ")) == 3 * (2 + 1)


def _value_of(trigger: Any, waiting: Mapping[str, int]) -> float:
    """What KEDA reads: the one sample of our own /metrics that a trigger's selector means."""
    assert trigger["type"] == "metrics-api"
    metadata = trigger["metadata"]
    assert set(metadata) == {"url", "format", "valueLocation", "targetValue"}
    assert all(isinstance(value, str) for value in metadata.values())
    address = urlsplit(metadata["url"])
    service = _named("Service", "api")
    assert address.hostname == f"{service['metadata']['name']}.{KUSTOMIZATION['namespace']}.svc"
    assert (address.port, address.path) == (_operations_port(), "/metrics")
    assert service["spec"]["ports"][1] == {"name": "operations", "port": address.port, "targetPort": "operations"}
    name, label = re.fullmatch(r'(\w+)\{queue="([\w-]+)"\}', metadata["valueLocation"]).groups()
    queues = [QueueLength(name=queue, jobs=jobs, oldest_s=0, running=1) for queue, jobs in waiting.items()]
    now = Census(jobs={}, queues=tuple(queues), workers=0, has_housekeeper=True, unsent_messages=0, stored_bytes=0)
    [value] = [
        sample.value
        for family in store_gauges(now, ())
        for sample in family.samples
        if (sample.name, sample.labels.get("queue")) == (name, label)
    ]
    return float(value)


def _operations_port() -> int:
    return int(_named("ConfigMap", "settings")["data"]["DYNAMICTREE_OPS_ADDRESS"].removeprefix("0.0.0.0:"))


def test_metrics_are_reached_by_keda_and_prometheus_alone() -> None:
    ports = {port["name"]: port["containerPort"] for port in _container("api")["ports"]}
    assert ports["operations"] == _operations_port()
    notes = _named("Deployment", "api")["spec"]["template"]["metadata"]["annotations"]
    assert notes["prometheus.io/port"] == str(_operations_port())
    everybody, operators = _named("NetworkPolicy", "api")["spec"]["ingress"]
    assert everybody == {"ports": [{"port": "http"}]}
    assert (bool(operators["from"]), operators["ports"]) == (True, [{"port": "operations"}])


@pytest.mark.parametrize("name", ["api", "worker", "worker-gpu", "housekeeper"])
def test_the_service_knows_what_its_volume_may_take(name: str) -> None:
    """statvfs of an emptyDir tells what the node has; beyond its sizeLimit the pod is evicted."""
    volumes = _named("Deployment", name)["spec"]["template"]["spec"]["volumes"]
    [limit] = [volume["emptyDir"]["sizeLimit"] for volume in volumes if volume["name"] == "state"]
    said = _named("ConfigMap", "settings")["data"]["DYNAMICTREE_STATE_SIZE_BYTES"]
    assert int(said) == int(limit.removesuffix("Gi")) * GIB


def test_what_is_not_ours_is_still_reached() -> None:
    """A policy for all pods of the namespace would cut the API off from a Redis that stands beside it."""
    policies = [o["spec"] for o in OBJECTS if o["kind"] == "NetworkPolicy"]
    assert all(policy["podSelector"] for policy in policies)
    [closed] = [policy for policy in policies if "ingress" not in policy]
    [chosen] = closed["podSelector"]["matchExpressions"]
    assert set(chosen["values"]) == {o["metadata"]["name"] for o in OBJECTS if o["kind"] == "Deployment"} - {"api"}


def test_selectors_choose_their_pods() -> None:
    names = {o["metadata"]["name"] for o in OBJECTS if o["kind"] == "Deployment"}
    for name in names:
        spec = _named("Deployment", name)["spec"]
        assert spec["selector"]["matchLabels"] == spec["template"]["metadata"]["labels"]
    assert _named("Service", "api")["spec"]["selector"] == {"app.kubernetes.io/name": "api"}
