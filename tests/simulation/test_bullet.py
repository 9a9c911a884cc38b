import pytest

from minitouch_bench import machine
from minitouch_bench.errors import UsageError
from minitouch_bench.simulation import bullet


@pytest.mark.parametrize(
    ("installed", "said"),
    [
        ({"pybullet": "3.2.6"}, "installed is pybullet 3.2.6: pip install {build}"),
        ({}, "installed is another: pip install {build}"),
    ],
)
@pytest.mark.parametrize(
    ("python", "build"),
    [((3, 11), "pybullet==3.2.7"), ((3, 13), "pybullet-arm64==3.2.8")],
)
def test_another_simulator_than_the_protocol_s_is_refused(
    monkeypatch, installed, said, python, build
):
    monkeypatch.setattr(bullet, "installed_versions", lambda _: installed)
    monkeypatch.setattr(bullet.sys, "version_info", python)
    with pytest.raises(UsageError, match=said.format(build=build)):
        bullet._check_build()


def test_either_build_of_the_protocol_s_simulator_will_do(monkeypatch):
    monkeypatch.setattr(machine, "version", bullet.BUILDS.__getitem__)
    bullet._check_build()
