import numpy as np

from minitouch_bench.protocol.spec import CameraSpec
from minitouch_bench.simulation.bodies import add_table
from minitouch_bench.simulation.bullet import View
from minitouch_bench.simulation.observation import GrayCamera

ABOVE = CameraSpec((0.5, 0.0, 0.0), yaw=0.0, pitch=-89.0, near=0.05, distance=0.7)


def scene(client):
    client.reset_world()
    table = add_table(client)
    thing = client.add_ghost_box((0.03,) * 3, (0.5, 0.0, 0.03), (0.2, 0.9, 0.1, 1.0))
    return table, thing


def test_the_picture_is_grey_with_the_weights_of_the_eye(client):
    table, _ = scene(client)
    rgb = client.render(View.of(ABOVE), 84, 84).rgb.astype(float)
    camera = GrayCamera(ABOVE)
    camera.keep_background(client, table, [])
    picture = camera.capture(client)
    assert (picture.shape, picture.dtype) == ((1, 84, 84), np.uint8)
    grey = rgb @ (0.2989, 0.5870, 0.1140)
    assert np.abs(picture[0] - grey).max() <= 0.6


def test_what_moves_is_drawn_where_it_is_and_leaves_nothing_behind(client):
    table, thing = scene(client)
    camera = GrayCamera(ABOVE)
    camera.keep_background(client, table, [])
    before = camera.capture(client)
    client.set_pose(thing, (0.6, 0.1, 0.03), (0, 0, 0, 1))
    moved = camera.capture(client)
    assert np.any(before != moved)
    client.set_pose(thing, (0.5, 0.0, 0.03), (0, 0, 0, 1))
    assert np.array_equal(camera.capture(client), before)


def test_what_is_behind_the_background_is_hidden(client):
    table, thing = scene(client)
    camera = GrayCamera(ABOVE)
    camera.keep_background(client, table, [])
    client.set_pose(thing, (0.5, 0.0, -0.08), (0, 0, 0, 1))  # inside the table
    buried = camera.capture(client)
    client.set_pose(thing, (9.0, 9.0, 0.03), (0, 0, 0, 1))
    assert np.array_equal(buried, camera.capture(client))
