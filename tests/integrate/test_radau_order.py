"""Orders of Radau IIA in q, v, a and lam on a chain in absolute coordinates, with and without friction in its joints."""

from functools import cache

import numpy as np
import pytest

import polyida as pi

LENGTH, LINKS, T_END = 0.2, 3, 0.2
ANGLES = np.array([-0.3, -0.5, -0.2])
LAWS = {"free": lambda speed: 0.0 * speed, "viscous": lambda speed: 0.02 * speed, "narrow": lambda speed: 0.05 * np.tanh(speed / 0.1)}


class Chain(pi.Model):
    """Rods of 1 kg and 0.2 m in a row, pinned at one end; q holds (x, y, angle) of each, `law` the joint torque over the relative speed."""

    n, m = 3 * LINKS, 2 * LINKS
    needs = pi.Needs(mass_varies=False, driven=False)

    def __init__(self, law):
        self.law = LAWS[law]

    def mass(self, q):
        return np.diag(np.tile([1.0, 1.0, LENGTH**2 / 12], LINKS))

    def force(self, t, q, v):
        torque = self.law(np.diff(v[2::3], prepend=0.0))
        weight, friction = np.tile([0.0, 9.81, 0.0], LINKS), np.zeros(self.n)
        friction[2::3] = torque - np.append(torque[1:], 0.0)
        return weight + friction

    def phi(self, t, q):
        middles = q.reshape(-1, 3)[:, :2]
        return (middles - half(q) - np.vstack([(0.0, 0.0), (middles + half(q))[:-1]])).ravel()

    def phi_q(self, t, q):
        rows = np.zeros((LINKS, 2, LINKS, 3))
        for k, (x, y) in enumerate(half(q)):
            rows[k, :, k] = (1.0, 0.0, y), (0.0, 1.0, -x)
            rows[k + 1 : k + 2, :, k] = (-1.0, 0.0, y), (0.0, -1.0, -x)
        return rows.reshape(self.m, self.n)


def half(q):
    """From the middle of each rod to its end, (LINKS, 2)."""
    return 0.5 * LENGTH * np.column_stack([np.cos(q[2::3]), np.sin(q[2::3])])


@cache
def swung(law, steps, t_end=T_END, stages=3):
    along = half(np.repeat(ANGLES, 3))
    middles = np.cumsum(2.0 * along, axis=0) - along
    q0 = np.column_stack([middles, ANGLES]).ravel()
    run = pi.solve(Chain(law), t_end, pi.RadauIIA(h=t_end / steps, stages=stages), q0=q0, every=10**9)
    assert run.success, run.message
    return run


def errors(law, steps, finest, **settings):
    """Of (q, v, a, lam) at the end, against a run of three stages with `finest` steps."""
    t_end = settings.get("t_end", T_END)
    found, exact = swung(law, steps, **settings).state, swung(law, finest, t_end).state
    return [np.abs(getattr(found, name) - getattr(exact, name)).max() for name in ("q", "v", "a", "lam")]


@pytest.mark.parametrize("law", ["free", "viscous"])
@pytest.mark.parametrize("stages, order, counts", [(2, 3, (20, 40, 80)), (3, 5, (16, 32, 48))])
def test_orders_of_a_chain_in_absolute_coordinates(scenes, law, stages, order, counts):
    found = np.array([errors(law, n, 160, stages=stages) for n in counts])
    assert all(swung(law, n, stages=stages).counts.rejected == 0 for n in counts)
    assert [scenes.slope(1.0 / np.array(counts), column) for column in found.T] == pytest.approx([order] * 4, abs=0.3)


def test_steps_that_are_cut_or_wider_than_a_friction_law_show_lower_orders():
    """Newton fails with the longest step and its parts have a smaller error; tanh of the speed turns within 0.1 rad/s, 2 ms of the motion."""
    assert [swung("free", n, 0.4).counts.rejected > 0 for n in (20, 40)] == [True, False]
    coarse, fine = (errors("free", n, 80, t_end=0.4) for n in (20, 40))
    assert np.log2(np.divide(coarse, fine)) == pytest.approx([3.4] * 4, abs=0.6)
    coarse, fine = (errors("narrow", n, 80)[0] for n in (10, 40))
    assert np.log2(coarse / fine) / 2 == pytest.approx(2.0, abs=0.3)
