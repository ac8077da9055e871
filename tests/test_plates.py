"""The flexible plates as registered scenes: what they are made of, and that they can be had by name."""

import numpy as np
import pytest

from polyida.problems import plates


def test_double_plate_has_the_stated_mass_and_places():
    scene = plates.double_plate(cells=12)
    model = scene.build()
    ex = np.tile([1.0, 0.0], model.n_nodes)
    assert ex @ (model.mass() @ ex) == pytest.approx(2 * 1100 * 1.0 * 0.1 * 0.01 + 0.5, rel=1e-12)
    assert model.reference.min(axis=0) == pytest.approx([0.0, -0.05])
    assert model.reference.max(axis=0) == pytest.approx([2.0, 0.05])
    for name, place in (("shoulder", (0, 0)), ("elbow", (1, 0)), ("tip", (2, 0))):
        assert model.attachment(name).point == pytest.approx(place, abs=1e-12)


def test_motors_add_one_row_a_joint_and_follow_the_quintic():
    free, driven = plates.double_plate(cells=12).build(), plates.double_plate_motors(cells=12).build()
    assert (free.m, driven.m) == (4, 6)
    assert not free.needs.driven and driven.needs.driven
    angle = driven.joints["elbow motor"].angle
    assert [angle(0.0), angle(0.5), angle(2.0)] == pytest.approx([0, np.pi / 8, np.pi / 4])


@pytest.mark.parametrize("links", [1, 4])
def test_chain_has_a_joint_a_link_and_meets_at_rest(links):
    model = plates.plate_chain(links, cells=6).build()
    assert len(model.bodies) == links and model.m == 2 * links
    assert np.abs(model.phi(0.0, np.zeros(model.n))).max() < 1e-14
