from importlib.metadata import PackageNotFoundError

import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.simulation import bullet


@pytest.mark.parametrize(
    ("installed", "said"),
    [
        ({"pybullet": "3.2.6"}, "installed is pybullet 3.2.6: pip install pybullet==3.2.7"),
        ({}, "installed is another"),
    ],
)
def test_another_simulator_than_the_protocol_s_is_refused(monkeypatch, installed, said):
    def version(name):
        if name not in installed:
            raise PackageNotFoundError(name)
        return installed[name]

    monkeypatch.setattr(bullet, "version", version)
    with pytest.raises(UsageError, match=said):
        bullet._check_build()


def test_either_build_of_the_protocol_s_simulator_will_do(monkeypatch):
    monkeypatch.setattr(bullet, "version", bullet.BUILDS.__getitem__)
    bullet._check_build()
