"""What is handed out is whole: the wheel holds all that runs, and the locks name a version of all that it needs."""

import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from zipfile import ZipFile

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
LOCKS = sorted((ROOT / "requirements").glob("*.lock"))


@pytest.mark.skipif(importlib.util.find_spec("hatchling") is None, reason="the build backend is not installed")
def test_the_wheel_holds_code_protocol_weights_migrations_and_licence_and_no_tests(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True, timeout=120)
    (wheel,) = tmp_path.glob("pretouch-*.whl")
    with ZipFile(wheel) as archive:
        held = set(archive.namelist())
        metadata = archive.read(next(name for name in held if name.endswith(".dist-info/METADATA"))).decode()
    wanted = {f"pretouch/v1/{proto.name}" for proto in (ROOT / "proto/pretouch/v1").glob("*.proto")}
    wanted |= {proto.replace(".proto", "_pb2.py") for proto in wanted}
    wanted |= {f"{package}/py.typed" for package in _packages()}
    wanted |= {
        f"pretouch_orchestrator/{name}" for name in ("dashboard/index.html", "dashboard/main.js", "report/views.js")
    }
    wanted |= {f"pretouch_detector/weights/scorer.{kind}" for kind in ("onnx", "json", "safetensors")}
    orchestrator = ROOT / "services/orchestrator"
    wanted |= {str(script.relative_to(orchestrator)) for script in orchestrator.glob("*/store/migrations/*/*.sql")}
    wanted |= {f"pretouch_orchestrator/report/{name}" for name in ("views.js", "boot.js", "style.css")}
    wanted |= {f"pretouch-{PROJECT['version']}.dist-info/licenses/LICENSE"}
    assert wanted <= held
    assert {name.split("/")[0] for name in held} == {*_packages(), f"pretouch-{PROJECT['version']}.dist-info"}
    assert "Provides-Extra: all" in metadata


def _packages() -> list[str]:
    hatch = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]
    return [Path(package).name for package in hatch["build"]["targets"]["wheel"]["packages"]]


@pytest.mark.parametrize("lock", LOCKS, ids=lambda lock: lock.stem)
def test_a_lock_has_hashes_names_no_index_and_a_version_of_each_requirement(lock: Path) -> None:
    text = lock.read_text()
    assert not re.search(r"https?://|file://|--index|--find-links", text)
    blocks = re.split(r"\n(?=\S)", text[text.index("\n", text.index("make lock")) :])
    locked: dict[str, list[str]] = {}
    for block in filter(str.strip, blocks):
        assert "--hash=sha256:" in block
        name, version = re.match(r"\s*([a-z0-9-]+)(?:\[[^\]]*\])?==(\S+)", block).groups()  # type: ignore[union-attr]
        locked.setdefault(name, []).append(version)
    for requirement in _requirements(lock.stem):
        versions = locked.get(re.sub(r"[-_.]+", "-", requirement.name).lower(), [])
        assert any(requirement.specifier.contains(version) for version in versions), f"{requirement}: run `make lock`"


def _requirements(extra: str) -> list[Requirement]:
    """What an extra of pretouch needs, those that it names of pretouch itself followed."""
    found = [Requirement(line) for line in PROJECT["dependencies"]]
    for requirement in map(Requirement, PROJECT["optional-dependencies"][extra]):
        if requirement.name == "pretouch":
            found += [inner for name in requirement.extras for inner in _requirements(name)]
        else:
            found.append(requirement)
    return found
