import numpy as np

from minitouch_bench.protocol.spec import Workspace
from minitouch_bench.tasks.task import draw_position

SPACE = Workspace((0.5, -0.2, 0.0), (0.7, 0.2, 0.1))


def test_holds_looks_from_above():
    assert SPACE.holds(0.5, 0.2)
    assert not SPACE.holds(0.499, 0.0)
    assert not SPACE.holds(0.6, 0.201)


def test_drawn_places_keep_the_margin_and_come_from_the_generator():
    places = [draw_position(SPACE, np.random.default_rng(seed), 0.05) for seed in range(100)]
    assert np.all(np.array(places) >= (0.55, -0.15))
    assert np.all(np.array(places) <= (0.65, 0.15))
    assert draw_position(SPACE, np.random.default_rng(7), 0.05) == places[7]
