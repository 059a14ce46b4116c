"""The command line as a user meets it: quick help, clear refusals, the health probe."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import entry_points, version
from pathlib import Path

import grpc
import pytest
from helpers.serving_probe import running

from pretouch.serving import ServiceContext, Settings, started

TIMEOUT = 60
WITHOUT_EXTRAS = """
import importlib.abc, sys
EXTRAS = {"cobs", "fastapi", "fastcrc", "matplotlib", "numba", "psycopg", "scipy", "serial", "shapely",
          "trimesh", "uvicorn"}
class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in EXTRAS:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
from pretouch.cli import main
sys.argv[0] = "pretouch"
try:
    main()
finally:
    print("imported:", *(sys.modules.keys() & {"httpx", "numpy", "prometheus_client", "pretouch.serving", "structlog"}))
"""
ENVIRONMENT = {key: value for key, value in os.environ.items() if not key.startswith("PRETOUCH_")} | {"COLUMNS": "120"}


def pretouch(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return _run("-m", "pretouch", *arguments, **environment)


def without_extras(*arguments: str) -> subprocess.CompletedProcess[str]:
    return _run("-c", WITHOUT_EXTRAS, *arguments)


def _run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        env=ENVIRONMENT | environment,
        check=False,
    )


def refused(result: subprocess.CompletedProcess[str], code: int = 2) -> str:
    """What the user was told: a detail and a remedy, and no trace."""
    assert result.returncode == code, result.stderr
    assert "Traceback" not in result.stderr
    assert len(result.stderr.strip().splitlines()) == 2
    return result.stderr


def test_help_lists_every_command_without_any_extra_and_without_importing_their_modules() -> None:
    result = without_extras("--help")
    assert result.returncode == 0, result.stderr
    for command in ("serve", "up", "healthcheck", *(entry.name for entry in entry_points(group="pretouch.commands"))):
        assert f" {command} " in result.stdout
    assert result.stdout.splitlines()[-1] == "imported:", "heavy imports make the help slow"


@pytest.mark.parametrize("service", ["detector", "registrar", "gateway", "orchestrator"])
def test_a_missing_extra_is_named(service: str) -> None:
    told = refused(without_extras("serve", service, "--port", "0"), 1)
    assert f"pip install 'pretouch[{service}]'" in told


def test_a_missing_extra_of_another_packages_command_is_named(tmp_path: Path) -> None:
    told = refused(without_extras("evaluate", "--meshes", str(tmp_path), "--json", str(tmp_path / "out.json")), 1)
    assert "pip install 'pretouch[simulation]'" in told


def test_the_version_is_the_installed_one() -> None:
    done = pretouch("--version")
    assert (done.returncode, done.stdout) == (0, f"pretouch {version('pretouch')}\n")


@pytest.mark.parametrize("command", [(), ("serve",), ("serve", "registrar"), ("up",)])
def test_help_has_a_short_name_everywhere(command: tuple[str, ...]) -> None:
    short, long = pretouch(*command, "-h"), pretouch(*command, "--help")
    assert (short.returncode, short.stdout) == (0, long.stdout)
    assert "Usage:" in short.stdout


def test_the_orchestrators_help_names_its_variables() -> None:
    text = pretouch("serve", "orchestrator", "--help").stdout
    for name in ("REST_HOST", "REST_PORT", "STATE", "DETECTOR", "REGISTRAR", "GATEWAY"):
        assert f"PRETOUCH_ORCHESTRATOR_{name}" in text


@pytest.mark.parametrize(
    ("arguments", "environment", "complaint"),
    [
        (("serve", "gateway", "--port", "70000"), {}, "The port is 70000"),
        (("serve", "gateway"), {"PRETOUCH_PORT": "70000"}, "The port is 70000"),
        (("serve", "gateway", "--port", "0", "--tls-cert", "c.pem"), {}, "certificate or a key, but not both"),
        (("serve", "gateway", "--port", "0"), {"PRETOUCH_LOG_LEVEL": "loud"}, "'loud'"),
        (("serve", "gateway", "--port", "0"), {"PRETOUCH_GATEWAY_DEVICES": "finger"}, "name=port"),
        (("up", "--device", "finger"), {}, "'finger' is not name=port"),
        (("up", "--rest-port", "50050"), {}, "REST and gRPC both have port 50050"),
        (("up", "--gateway-port", "8080"), {}, "REST and the gateway both have port 8080"),
        (("up", "--tls-cert", "c.pem"), {}, "certificate or a key, but not both"),
        (("up",), {"PRETOUCH_TLS_CERT": "/none/c.pem", "PRETOUCH_TLS_KEY": "/none/k.pem"}, "/none/c.pem"),
        (("up", "--state", "/proc/state"), {}, "/proc/state cannot be written"),
        (("up", "--config", "/none/up.toml"), {}, "no file /none/up.toml"),
        (("healthcheck", "nowhere"), {}, "'nowhere' is not a gRPC address"),
    ],
)
def test_what_the_user_can_put_right_is_said_in_two_lines(
    arguments: tuple[str, ...], environment: dict[str, str], complaint: str
) -> None:
    assert complaint in refused(pretouch(*arguments, **environment))


def test_an_unknown_command_or_option_is_a_usage_error() -> None:
    for arguments in (("nonsense",), ("serve", "nonsense"), ("up", "--nonsense")):
        result = pretouch(*arguments)
        assert result.returncode == 2
        assert "nonsense" in result.stderr
        assert "Traceback" not in result.stderr


async def test_healthcheck_tells_serving_from_warming_up_from_absent() -> None:
    async def probe(port: int) -> int:
        result = await asyncio.to_thread(pretouch, "healthcheck", PRETOUCH_PORT=str(port))
        return result.returncode

    entered, warm = asyncio.Event(), asyncio.Event()

    @asynccontextmanager
    async def slow(server: grpc.aio.Server, context: ServiceContext) -> AsyncIterator[tuple[str, ...]]:
        async with running(server, context) as names:
            entered.set()
            await warm.wait()
            yield names

    async with started("probe", running, Settings(token="health needs none")) as service:
        port = service.port
        assert await probe(port) == 0
    assert await probe(port) == 1

    async def serve_slowly() -> None:
        async with started("probe", slow, Settings(port=port)):
            pass

    serving = asyncio.create_task(serve_slowly())
    await entered.wait()
    assert await probe(port) == 1
    warm.set()
    await serving


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("rest-port = 8081\nrestport = 8082\ndemo = 1", "unknown keys: restport, demo"),
        ("rest-port", "is not TOML"),
        ("rest-port = 50050", "REST and gRPC both have port 50050"),
        ('device = ["finger"]', "'finger' is not name=port"),
        ('device = "finger"', "'finger' is not name=port"),
        ('token = ""', "The token is empty"),
    ],
)
def test_a_configuration_file_gives_up_its_options(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "up.toml"
    path.write_text(text)
    assert said in refused(pretouch("up", "--config", str(path)))


def test_a_wrong_value_in_a_configuration_file_is_a_usage_error_and_the_command_line_comes_first(
    tmp_path: Path,
) -> None:
    path = tmp_path / "up.toml"
    path.write_text('rest-port = "many"')
    done = pretouch("up", "--config", str(path))
    assert done.returncode == 2
    assert "--rest-port" in done.stderr
    assert "both have port 50050" in refused(pretouch("up", "--config", str(path), "--rest-port", "50050"))
