"""Ordinary meshes as people have them: imported, evaluated, verified and compared."""

import json
import re
import shutil

import numpy as np
import pytest
import trimesh
from trimesh import creation

from minitouch_bench import api
from tests.commands.command import run, succeed


def ordinary():
    """Return things by name, sizes in m."""
    hollow = creation.cylinder(0.033, 0.07).apply_translation((0, 0, 0.006))
    foot = creation.box((0.03, 0.03, 0.06)).apply_translation((-0.02, 0, 0.015))
    slope = [[0, 0, 0], [8, 0, 0], [8, 5, 0], [0, 5, 0], [8, 0, 5], [8, 5, 5]]
    return {
        "ball": creation.icosphere(3, 0.033),
        "cup": trimesh.boolean.difference([creation.cylinder(0.038, 0.07), hollow]),
        "ring": creation.annulus(0.025, 0.04, 0.02),
        "ell": trimesh.boolean.union([creation.box((0.07, 0.03, 0.03)), foot]),
        "cube": creation.box((0.056,) * 3),
        "cylinder": creation.cylinder(0.03, 0.08),
        "wedge": trimesh.convex.convex_hull(np.array(slope) / 100),
    }


@pytest.fixture(scope="module")
def mine(tmp_path_factory):
    """A folder with six of the meshes in mm, one in m, and the set of the six."""
    folder = tmp_path_factory.mktemp("mine")
    (folder / "meshes").mkdir()
    for name, mesh in ordinary().items():
        mesh.apply_scale(1.0 if name == "wedge" else 1000.0)
        mesh.export(folder / "meshes" / f"{name}.stl")
    done = run("shapes", "import", "meshes", "--output", "set", "--scale", 0.001, directory=folder)
    return folder, done


def test_ordinary_meshes_are_accepted_and_what_is_not_promised_is_said(mine):
    folder, done = mine
    assert done.code == 1
    assert "6 accepted, 1 refused" in done.out
    assert "--scale FILE=X" in done.err
    both = ("--output", "fitted", "--fit", "--scale", 0.001)
    run("shapes", "import", "meshes", *both, directory=folder).refused(2, "leave --scale out")
    assert re.search(r"wedge.stl: .*0.1 mm, not 10 to 125 mm.; accepted with --scale 1\b", done.out)
    assert re.search("ball.stl: .*fewer than two stable poses", done.out)
    assert re.search("ring.stl: .*8 of 8 grips fail", done.out)
    assert "cylinder.stl" not in done.out
    shapes = json.loads((folder / "set" / "manifest.json").read_text())["shapes"]
    said = {shape["name"]: shape["not_promised"] for shape in shapes}
    assert said["cylinder"] == []
    assert all(text in done.out for texts in said.values() for text in texts)
    succeed("shapes", "check", "set", directory=folder)


def test_own_objects_are_evaluated_verified_and_compared(mine, tmp_path):
    shutil.copytree(mine[0] / "set", tmp_path / "set")
    options = ("--objects", "set", "--suite", "smoke", "--episodes", 1, "--workers", 2)
    for policy in ("random", "zero"):
        done = succeed("evaluate", policy, *options, "--output", policy, directory=tmp_path)
        assert "objects set" in done.out
    played = api.load_run(tmp_path / "random")
    assert played.tasks == ("playing", "pushing", "pick-up")
    assert {*played.episodes["shape"]} == {"ball"}
    assert (played.episodes["touch_interaction"] > 0).any()
    succeed("compare", "zero", "random", directory=tmp_path)
    succeed("verify", "random", directory=tmp_path)
    (tmp_path / "set").rename(tmp_path / "away")
    run("verify", "random", directory=tmp_path).refused(2, "objects of the run are gone")
    run("replay", "random", "pushing/0", directory=tmp_path).refused(2, "gone")
