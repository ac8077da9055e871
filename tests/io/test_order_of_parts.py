"""Parts stand in files in the order in which they were added, joints and forces before their bodies too."""

import numpy as np

import polyida as pi


def test_a_joint_may_stand_before_its_body(tmp_path):
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = pi.RigidBody.bar(1.0, 1.0, name="bar")
    tail = pi.RigidBody.bar(0.5, 1.0, origin=(1.0, 0.0), name="tail")
    scene.add(pi.Revolute(bar.at("right"), tail.at("left"), name="elbow"))
    scene.add(pi.Force(tail.at("right"), (1.0, pi.profile.sine(2.0, 1.0)), name="push"))
    scene.add(tail)
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="hinge"))
    scene.add(bar)
    run = pi.solve(scene.build(), 0.02, pi.GeneralizedAlpha(h=1e-3), out=tmp_path / "run.h5")
    again = pi.load(tmp_path / "run.h5")
    assert [*again.model.parts] == ["elbow", "push", "tail", "hinge", "bar"]
    assert np.array_equal(again.position("elbow"), run.position("elbow"))
    more = pi.resume(tmp_path / "run.h5", 0.03)
    assert more.success and more.t[-1] == 0.03
