"""Scenes: adding parts, names, building."""

import numpy as np
import pytest

import polyida as pi


def test_add_returns_the_part_and_counts_the_nameless(scenes):
    scene, upper = scenes.single()
    assert scene.parts["upper"] is upper
    left = upper.section("left")
    parts = [scene.add(part) for part in (pi.Revolute(pi.ground, left), pi.Revolute(pi.ground, left), pi.PointMass(left, 1.0))]
    assert list(scene.parts) == ["upper", "revolute 1", "revolute 2", "mass 1"] and list(scene.parts.values())[1:] == parts


def test_a_taken_number_is_skipped(scenes):
    scene, upper = scenes.single()
    scene.add(pi.PointMass(upper.section("left"), 1.0, name="mass 2"))
    scene.add(pi.PointMass(upper.section("left"), 1.0))
    assert sorted(scene.parts) == ["mass 2", "mass 3", "upper"]


def test_what_is_no_part(scenes):
    scene, upper = scenes.single()
    for wrong in (None, "plate", upper.section("left"), scenes.mesh(), pi.Plate):
        with pytest.raises(pi.InputError, match="no part"):
            scene.add(wrong)


def test_a_scene_grows_after_it_was_built(scenes):
    scene, upper = scenes.hinged()
    before = scene.build()
    scene.add(pi.PointMass(upper.section("right"), 1.0, name="tip"))
    after = scene.build()
    ones = np.tile([1.0, 0.0], before.n_nodes)
    assert ones @ (after.mass() @ ones) - ones @ (before.mass() @ ones) == pytest.approx(1.0)
    assert "tip" not in before.parts


def test_a_plate_placed_by_angle_and_origin(scenes):
    upper = scenes.plate("upper", angle=np.pi / 2, origin=(3.0, 1.0))
    assert np.allclose(upper.points[:, 0].max() - 3.0, 0.05) and np.allclose(upper.points[:, 1].max(), 2.0)
