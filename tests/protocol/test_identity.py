from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.protocol import identity
from minitouch_bench.protocol.identity import protocol_constants, protocol_digest
from minitouch_bench.sensing import camera
from minitouch_bench.simulation import bodies, client, panda_arm, scene
from minitouch_bench.tasks import opening, pick_up, pushing, tabletop, task

digest_now = protocol_digest.__wrapped__


def test_the_digest_is_a_sha256_and_stays():
    assert len(protocol_digest()) == 64
    assert digest_now() == digest_now() == protocol_digest()


@pytest.mark.parametrize(
    ("module", "name", "value"),
    [
        (pushing, "SUCCESS_DISTANCE_M", 0.077),
        (opening, "SUCCESS_ANGLE_RAD", 0.57),
        (opening, "CABINET", replace(opening.CABINET, hinge_friction=0.4)),
        (pick_up, "LIFT_M", 0.06),
        (tabletop, "MARGIN_M", 0.06),
        (task, "MAX_STEPS", 100),
        (panda_arm, "TOLERANCE_M", 1e-3),
        (client, "GRAVITY_M_S2", -9.81),
        (scene, "TABLE_COLOR", (0.0, 0.0, 0.0, 1.0)),
        (bodies, "CUBE_COLOR", "0 0 0 1"),
        (camera, "IMAGE_SIZE", 96),
        (identity, "RULES", identity.RULES + 1),
        (identity, "PROTOCOL", "minitouch-v2"),
    ],
)
def test_it_changes_with_every_constant(monkeypatch, module, name, value):
    monkeypatch.setattr(module, name, value)
    assert digest_now() != protocol_digest()


@pytest.mark.parametrize("part", ["simulator_version", "shape_set_digest"])
def test_it_changes_with_the_simulator_and_the_shapes(monkeypatch, part):
    monkeypatch.setattr(identity, part, lambda: "another")
    assert digest_now() != protocol_digest()


def test_it_changes_with_a_preset_but_not_with_a_picture_for_people(monkeypatch):
    preset = pushing.Pushing.preset
    monkeypatch.setattr(pushing.Pushing, "preset", replace(preset, force_limit=10.0))
    assert digest_now() != protocol_digest()
    looks = replace(preset, portrait=replace(preset.portrait, yaw=1.0), goal="win")
    monkeypatch.setattr(pushing.Pushing, "preset", looks)
    assert digest_now() == protocol_digest()


def test_the_constants_are_plain():
    kinds = {type(value) for value in protocol_constants().values()}
    assert kinds <= {int, float, str, tuple, list, dict}
    assert not any(isinstance(value, np.generic) for value in protocol_constants().values())
