import os
import platform
import subprocess
import sys

import pytest

from minitouch_bench.arithmetic import SETTINGS, same_arithmetic

SINES = """
import hashlib, numpy as np
x = np.random.default_rng(0).uniform(-3, 3, 100_000)
print(hashlib.sha256(np.sin(x).tobytes()).hexdigest())
m = np.random.default_rng(1).normal(size=(300, 300))
print(hashlib.sha256((m @ m).tobytes()).hexdigest())
"""


def test_the_settings_hold_for_what_is_started_meanwhile_and_no_longer(monkeypatch):
    for name in SETTINGS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    with same_arithmetic():
        assert {name: os.environ[name] for name in SETTINGS} == SETTINGS
    assert {name: os.environ.get(name) for name in SETTINGS} == {
        name: "7" if name == "OMP_NUM_THREADS" else None for name in SETTINGS
    }


@pytest.mark.skipif(platform.machine() != "x86_64", reason="settings of x86-64")
def test_numpy_heeds_them_without_a_word():
    environment = {name: value for name, value in os.environ.items() if name not in SETTINGS}
    results = [
        subprocess.run(
            [sys.executable, "-c", SINES],
            env={**environment, **extra},
            capture_output=True,
            text=True,
            check=True,
        )
        for extra in (SETTINGS, {**SETTINGS, "OPENBLAS_NUM_THREADS": "1"}, {})
    ]
    assert results[0].stderr == ""
    assert results[0].stdout == results[1].stdout
    with open("/proc/cpuinfo", encoding="utf-8") as file:
        newer = "avx512f" in file.read()
    if newer:  # else the settings are what this processor does anyway
        assert results[0].stdout != results[2].stdout
