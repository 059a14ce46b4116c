"""An answer does not depend on the process that gives it: two registrars behind one address say the same."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import registration_probe
from pretouch_registrar.registration import Registrar

TESTS = Path(__file__).parents[1]


@pytest.mark.parametrize("half_angle", [0.0, float(np.radians(12.5))], ids=["thin", "wide"])
def test_two_processes_give_the_same_answer_to_the_last_bit(half_angle: float) -> None:
    command = [sys.executable, "-m", "helpers.registration_probe", repr(half_angle)]
    other = subprocess.run(command, cwd=TESTS, check=True, capture_output=True, text=True, timeout=240).stdout.strip()
    assert other == registration_probe.bits(Registrar().register(*registration_probe.session(half_angle)))
