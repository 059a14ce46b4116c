"""The Helm chart, rendered by a real helm and checked against Kubernetes' own schemas; no cluster is needed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from helpers.helm import find_helm, run_helm
from prometheus_client import CollectorRegistry

from pretouch.serving import ServiceContext, Settings

kubernetes_validate = pytest.importorskip("kubernetes_validate")
yaml = pytest.importorskip("yaml")

CHART = Path(__file__).parents[2] / "deploy" / "helm" / "pretouch"
VERSION = "1.35"
EVERYTHING = """
orchestrator: {autoscaling: {enabled: true}, service: {type: LoadBalancer, annotations: {a: b}}}
registrar: {engine: paper, autoscaling: {enabled: true}}
detector: {autoscaling: {enabled: true}}
gateway: {enabled: true, devices: "finger=socket://10.0.0.7:5000", nodeSelector: {robot: "1"}}
podMonitor: {enabled: true, labels: {release: prometheus}}
tracing: {endpoint: "http://collector:4317"}
token: {secret: pretouch-token}
env: [{name: PRETOUCH_WORKERS, value: "4"}]
imagePullSecrets: [{name: registry}]
nodeSelector: {zone: a}
tolerations: [{key: robots, operator: Exists}]
networkPolicy: {robots: [{ipBlock: {cidr: 10.1.0.0/16}}], monitoring: [{namespaceSelector: {matchLabels: {a: b}}}]}
"""


@pytest.fixture(scope="module")
def helm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = find_helm(tmp_path_factory.mktemp("helm"))
    if found is None:
        pytest.skip("helm is not installed")
    return found


@pytest.fixture(scope="module", params=["", EVERYTHING], ids=["defaults", "everything"])
def documents(request: pytest.FixtureRequest, helm: Path) -> list[dict[str, Any]]:
    """What the chart makes of the defaults, and of all that can be switched on."""
    values = helm.parent / "values.yaml"
    values.write_text(request.param)
    text = run_helm(helm, "template", "cell", CHART, "--values", values).stdout
    return [document for document in yaml.safe_load_all(text) if document]


def pods(documents: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """The pod template of each component."""
    kinds = ("Deployment", "StatefulSet", "DaemonSet")
    templates = [document["spec"]["template"] for document in documents if document["kind"] in kinds]
    return {template["metadata"]["labels"]["app.kubernetes.io/component"]: template for template in templates}


def test_the_chart_passes_helms_own_lint(helm: Path) -> None:
    run_helm(helm, "lint", "--strict", CHART)


def test_every_document_is_what_kubernetes_takes(documents: list[dict[str, Any]]) -> None:
    names = [(document["kind"], document["metadata"]["name"]) for document in documents]
    assert len(set(names)) == len(names)
    for document in documents:
        if document["kind"] != "PodMonitor":  # the Prometheus operator's
            kubernetes_validate.validate(document, VERSION, strict=True)


def test_pods_are_hardened_bounded_and_probed(documents: list[dict[str, Any]]) -> None:
    for template in pods(documents).values():
        pod, (container,) = template["spec"], template["spec"]["containers"]
        assert pod["securityContext"]["runAsNonRoot"] is True
        assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
        assert pod["automountServiceAccountToken"] is False
        assert container["securityContext"] == {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        }
        assert container["resources"]["limits"]["memory"]
        ports = {port["name"]: port["containerPort"] for port in container["ports"]}
        for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
            asked = container[probe].get("grpc") or container[probe]["httpGet"]
            assert ports.get(asked["port"], asked["port"]) in ports.values()


def test_what_selects_pods_selects_those_of_its_component(documents: list[dict[str, Any]]) -> None:
    labels = {component: template["metadata"]["labels"] for component, template in pods(documents).items()}
    for document in documents:
        spec = document["spec"]
        selector = spec.get("selector") or spec.get("podSelector") or {}
        wanted = selector.get("matchLabels", selector)
        if wanted:
            component = document["metadata"]["labels"].get("app.kubernetes.io/component")
            chosen = [name for name, has in labels.items() if wanted.items() <= has.items()]
            assert chosen == ([component] if component else list(labels)), document["metadata"]
    disruptions = [document for document in documents if document["kind"] == "PodDisruptionBudget"]
    assert len(disruptions) == 3


def test_autoscaling_follows_a_metric_that_the_service_exports(documents: list[dict[str, Any]]) -> None:
    for document in documents:
        if document["kind"] == "HorizontalPodAutoscaler":
            component = document["metadata"]["labels"]["app.kubernetes.io/component"]
            (metric,) = document["spec"]["metrics"]
            assert metric["pods"]["metric"]["name"] in exported(ServiceContext(component, Settings()).metrics.registry)


def test_rest_is_called_by_the_names_of_its_service(documents: list[dict[str, Any]]) -> None:
    (container,) = pods(documents)["orchestrator"]["spec"]["containers"]
    variables = {variable["name"]: variable.get("value") for variable in container["env"]}
    names = variables["PRETOUCH_ORCHESTRATOR_ALLOWED_HOSTS"].split(",")
    assert names[:2] == ["cell-orchestrator.default", "cell-orchestrator.default.svc"]


def exported(registry: CollectorRegistry) -> set[str]:
    return {metric.name for metric in registry.collect()}


def test_registrars_are_named_one_by_one_unless_their_number_changes(documents: list[dict[str, Any]]) -> None:
    (container,) = pods(documents)["orchestrator"]["spec"]["containers"]
    variables = {variable["name"]: variable.get("value") for variable in container["env"]}
    registrars = variables["PRETOUCH_ORCHESTRATOR_REGISTRAR"]
    if any(document["kind"] == "HorizontalPodAutoscaler" for document in documents):
        assert registrars == "dns:///cell-registrar:50052"
    else:
        assert registrars == ",".join(f"cell-registrar-{k}.cell-registrar:50052" for k in range(3))


@pytest.mark.parametrize("wrong", ["registrar.replicas=0", "registrar.engine=guess", "podMonitor.interval=soon", "a=b"])
def test_values_that_cannot_be_are_refused(helm: Path, wrong: str) -> None:
    done = run_helm(helm, "template", "cell", CHART, "--set", wrong, check=False)
    assert done.returncode != 0
    assert "values don't meet the specifications of the schema" in done.stderr
