"""Engine `pcl` beside PCL itself, where PCL's bench program can be had."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from pretouch_registrar.engines import pcl

from benchmarks.registration import find_shared_peers
from benchmarks.registration_cases import make_cases
from benchmarks.registration_peers import write_cases

CASES = 24
CLOSE = 0.0005
"""m."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = find_shared_peers()
    if (source / "bench").is_file():
        return source / "bench"
    if not (source / "bench.cpp").is_file():
        pytest.skip(f"no bench.cpp in {source}; point PRETOUCH_SHARED at a folder with peers/pcl")
    folder = tmp_path_factory.mktemp("pcl")
    for name in ("bench.cpp", "build.sh"):
        (folder / name).write_bytes((source / name).read_bytes())
    built = subprocess.run(["sh", "build.sh"], cwd=folder, capture_output=True, text=True, timeout=280)
    if built.returncode:
        pytest.skip("PCL's headers are not installed (Debian: libpcl-dev libeigen3-dev g++)")
    return folder / "bench"


def test_matches_are_those_of_pcl(bench: Path, tmp_path: Path) -> None:
    cases = make_cases(CASES, seed=1)
    write_cases(cases, tmp_path / "cases.bin")
    words = [bench, tmp_path / "cases.bin", "vartrim", "1", tmp_path / "out.csv"]
    subprocess.run(words, check=True, capture_output=True, timeout=120)
    theirs = np.loadtxt(tmp_path / "out.csv", delimiter=",")[:, 3:].reshape(-1, 3, 4)
    apart = []
    for case, match in zip(cases, theirs, strict=True):
        ours = pcl.align(case.source, case.target)
        assert ours is not None
        difference = ours.apply(case.source) - (case.source @ match[:, :3].T + match[:, 3])
        apart.append(np.linalg.norm(difference, axis=1).mean())
    assert np.mean(np.array(apart) < CLOSE) >= 0.9
