from benchmarks.panda_meshes import write_meshes
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.simulation.panda_model import MESHES, light_panda


def test_the_committed_meshes_are_made_from_the_installed_panda(tmp_path):
    write_meshes(tmp_path)
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert made == {path.name: path.read_bytes() for path in MESHES.iterdir()}


def test_the_urdf_has_the_protocol_s_fingers_and_colors():
    text = light_panda().read_text()
    assert text.count(f'<stiffness value="{PROTOCOL.physics.finger_stiffness}"') == 2
    assert text.count(f'<damping value="{PROTOCOL.physics.finger_damping}"') == 2
    client = PhysicsClient()
    body = client.load_urdf(light_panda(), fixed=True)
    colors = set(client.colors().values())
    client.close()
    assert body == 0
    assert len(colors) == 2
