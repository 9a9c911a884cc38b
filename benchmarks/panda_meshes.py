"""Make ``minitouch_bench/simulation/panda/*.obj`` from the Panda that ``pybullet_data`` installs.

``python -m benchmarks.panda_meshes [DIRECTORY]``; the committed files are what it writes.
"""

import sys
from pathlib import Path

import fast_simplification
import numpy as np
import trimesh

from minitouch_bench.simulation.bodies import MESHES, stock_panda

LIGHT_TRIANGLES = 90
"""Triangles kept of each link; at 84 x 84 pixels more cannot be told apart."""


def write_meshes(directory: Path) -> None:
    """Write the light meshes of all links, and the hand's hull as installed."""
    directory.mkdir(parents=True, exist_ok=True)
    for source in sorted((stock_panda().parent / "meshes" / "collision").glob("*.obj")):
        mesh = trimesh.load_mesh(source)
        # The simplifier tears holes between vertices that differ in nothing but their normal.
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        if source.stem == "hand":
            _write(directory / "hand-stock.obj", vertices, faces)
        if len(faces) > LIGHT_TRIANGLES:
            # The simplifier stalls on coordinates in meters; in centimeters it does not.
            vertices, faces = fast_simplification.simplify(
                vertices * 100.0, faces, target_count=LIGHT_TRIANGLES, agg=7
            )
            vertices = vertices / 100.0
        _write(directory / f"{source.stem}-light.obj", vertices, faces)


def _write(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


if __name__ == "__main__":
    write_meshes(Path(sys.argv[1]) if len(sys.argv) > 1 else MESHES)
