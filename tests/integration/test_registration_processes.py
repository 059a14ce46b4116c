"""An answer does not depend on the process that gives it: two registrars behind one address say the same."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import registration_probe
from pretouch_registrar.registration import Registrar

PROBE = Path(registration_probe.__file__)


@pytest.mark.parametrize("half_angle", [0.0, float(np.radians(12.5))], ids=["thin", "wide"])
def test_two_processes_give_the_same_answer_to_the_last_bit(half_angle: float) -> None:
    command = [sys.executable, str(PROBE), repr(half_angle)]
    other = subprocess.run(command, check=True, capture_output=True, text=True, timeout=240).stdout.strip()
    assert other == registration_probe.bits(Registrar().register(*registration_probe.session(half_angle)))
