"""Checks of cardillo."""

import numpy as np

from peers_table.rows import GRAVITY, T_END, only, require, swung


def options(**values):
    from cardillo.solver import SolverOptions

    return SolverOptions(newton_atol=1e-10, newton_rtol=1e-10, **values)


def pendulum(mass=None):
    """A system of a point mass on a rod of 1 m, weight along -z."""
    from cardillo import System
    from cardillo.constraints import FixedDistance
    from cardillo.discrete import PointMass
    from cardillo.forces import Force

    system = System()
    mass = mass or PointMass(1.0, q0=np.array([1.0, 0.0, 0.0]), u0=np.zeros(3))
    system.add(mass, Force(np.array([0.0, 0.0, -GRAVITY]), mass), FixedDistance(system.origin, mass))
    system.assemble(options=options())
    return system


def swings(solver, bound=1e-3):
    """Description of the pendulum's end; the solver is created from the system."""
    run = solver(pendulum()).solve()
    return swung(run.q[np.argmin(np.abs(run.t - T_END))][[0, 2]], bound)


def by_dae(method):
    from cardillo.solver import ScipyDAE

    return lambda system: ScipyDAE(system, T_END, 0.05, method=method, rtol=1e-6, atol=1e-6)


def by_rattle(system):
    from cardillo.solver import Rattle

    return Rattle(system, T_END, 1e-3, options=options())


def cantilever():
    """A clamped rod of 1 m under the end moment that bends it to a half circle."""
    from cardillo import System
    from cardillo.constraints import RigidConnection
    from cardillo.forces import B_Moment
    from cardillo.rods import RectangularCrossSection, Simo1986
    from cardillo.rods.cosseratRod import make_CosseratRod
    from cardillo.solver import Newton

    kind, system = make_CosseratRod(interpolation="SE3", mixed=False), System()
    start = kind.straight_configuration(8, 1.0)
    law = Simo1986(np.array([1e3, 1e3, 1e3]), np.array([1.0, 1.0, 1.0]))
    rod = kind(RectangularCrossSection(0.01, 0.01), law, 8, Q=start, q0=start)
    system.add(rod, RigidConnection(system.origin, rod, xi2=(0,)))
    system.add(B_Moment(lambda t: np.array([0.0, 0.0, np.pi * t]), rod, (1,)))
    system.assemble(options=options(compute_consistent_initial_conditions=False))
    run = Newton(system, n_load_steps=10, verbose=False, options=options()).solve()
    end = rod.r_OP(1.0, run.q[-1][rod.qDOF][rod.local_qDOF_P((1,))], (1,))
    away = float(np.linalg.norm(end - [0.0, 2 / np.pi, 0.0]))
    require(away < 1e-3, f"its end is {away:.1e} m from that of a half circle")
    return f"a rod bent to a half circle ends {away:.1e} m from where it should"


def joints():
    """A block falls along a prismatic joint; a wheel on a revolute joint is turned by a motor's torque."""
    from cardillo import System
    from cardillo.actuators import Motor
    from cardillo.constraints import Prismatic, Revolute
    from cardillo.discrete import RigidBody
    from cardillo.forces import Force
    from cardillo.solver import ScipyDAE

    system = System()
    bodies = [RigidBody(1.0, np.eye(3), q0=RigidBody.pose2q(np.array([x, 0.0, 0.0]), np.eye(3)), name=f"body {x}") for x in (0.0, 3.0)]
    wheel, block = bodies
    pin = Revolute(system.origin, wheel, axis=2, r_OJ0=np.zeros(3), A_IJ0=np.eye(3))
    guide = Prismatic(system.origin, block, axis=1, r_OJ0=np.array([3.0, 0.0, 0.0]), A_IJ0=np.eye(3))
    system.add(*bodies, pin, guide, Motor(pin, lambda t: 1.0), Force(np.array([0.0, -GRAVITY, 0.0]), block))
    system.assemble(options=options())
    run = ScipyDAE(system, T_END, 0.05, rtol=1e-6, atol=1e-6).solve()
    last = np.argmin(np.abs(run.t - T_END))
    turned = pin.angle(T_END, run.q[last][pin.qDOF])
    fallen = run.q[last][block.qDOF][1] + GRAVITY * T_END**2 / 2
    require(abs(turned - T_END**2 / 2) < 1e-4 and abs(fallen) < 1e-4, f"turned by {turned}, {fallen} m off")
    return f"a wheel turned by {turned:.4f} rad of {T_END**2 / 2:g} under a motor's torque, a block slides"


def stops():
    """A mass that slides on a plane comes to rest by friction, after v^2 / (2 mu g)."""
    from cardillo import System
    from cardillo.contacts import Sphere2Plane
    from cardillo.discrete import PointMass
    from cardillo.forces import Force
    from cardillo.solver import Moreau

    system, speed, mu = System(), 1.0, 0.3
    mass = PointMass(1.0, q0=np.zeros(3), u0=np.array([speed, 0.0, 0.0]))
    system.add(mass, Force(np.array([0.0, 0.0, -GRAVITY]), mass), Sphere2Plane(system.origin, mass, mu))
    system.assemble(options=options())
    end = Moreau(system, T_END, 1e-3, options=options()).solve().q[-1][0]
    wanted = speed**2 / (2 * mu * GRAVITY)
    require(abs(end - wanted) < 2e-3, f"it stops after {end:.4f} m, not {wanted:.4f} m")
    return f"a sliding mass stops after {end:.4f} m, by Coulomb's law {wanted:.4f} m"


class Point:
    """A user-defined point mass with all methods that a system requires."""

    def __init__(self):
        self.nq = self.nu = 3
        self.q0, self.u0, self.name, self.constant_mass_matrix = np.array([1.0, 0.0, 0.0]), np.zeros(3), "own point", True

    def q_dot(self, t, q, u):
        return u

    def q_dot_u(self, t, q):
        return np.eye(3)

    def M(self, t, q):
        return np.eye(3)

    def local_qDOF_P(self, xi=None):
        return np.arange(3)

    def local_uDOF_P(self, xi=None):
        return np.arange(3)

    def r_OP(self, t, q, xi=None, B_r_CP=None):
        return q

    def r_OP_q(self, t, q, xi=None, B_r_CP=None):
        return np.eye(3)

    def v_P(self, t, q, u, xi=None, B_r_CP=None):
        return u

    def v_P_q(self, t, q, u, xi=None, B_r_CP=None):
        return np.zeros((3, 3))

    def J_P(self, t, q, xi=None, B_r_CP=None):
        return np.eye(3)

    def J_P_q(self, t, q, xi=None, B_r_CP=None):
        return np.zeros((3, 3, 3))

    def a_P(self, t, q, u, u_dot, xi=None, B_r_CP=None):
        return u_dot

    def a_P_q(self, t, q, u, u_dot, xi=None, B_r_CP=None):
        return np.zeros((3, 3))

    def a_P_u(self, t, q, u, u_dot, xi=None, B_r_CP=None):
        return np.zeros((3, 3))


def own_model():
    result = []
    for solver in (by_dae("Radau"), by_rattle):
        run = solver(pendulum(Point())).solve()
        result.append(swung(run.q[np.argmin(np.abs(run.t - T_END))][[0, 2]], 1e-3))
    return "; ".join(result)


def own_solver():
    """Symplectic Euler with projection, on the system's own M, h, g and W_g."""
    system, h = pendulum(), 1e-3
    t, q, u = 0.0, system.q0.copy(), system.u0.copy()
    for _ in range(round(T_END / h)):
        W, B = np.linalg.inv(system.M(t, q).toarray()), system.W_g(t, q).toarray()
        u = u + h * W @ system.h(t, q, u)
        u = u - W @ B @ np.linalg.solve(B.T @ W @ B, B.T @ u)
        q = q + h * u
        for _ in range(3):
            B = system.W_g(t, q).toarray()
            q = q - B @ np.linalg.solve(B.T @ B, system.g(t, q))
        t += h
    return swung(q[[0, 2]], 1e-2)


def solvers():
    import cardillo.solver as module

    return [name for name in vars(module) if name[0].isupper()]


def counts():
    summary = by_rattle(pendulum()).solve().solver_summary
    require(bool(summary.newton_n_iter_list), "no counts")
    return f"Newton iterations {sum(summary.newton_n_iter_list)}, factorizations {summary.n_lu}"


CHECKS = {
    "bodies in three dimensions": lambda: swings(by_dae("Radau")),
    "rods or shells under large rotation": cantilever,
    "revolute, prismatic, motor": joints,
    "contact with friction": stops,
    "a model of one's own": own_model,
    "generalized-alpha on index 3": lambda: only(solvers(), ["alpha"]),
    "stabilised index 2 (GGL)": lambda: swings(by_dae("Radau")),
    "BDF of variable order": lambda: swings(by_dae("BDF")),
    "Radau IIA": lambda: swings(by_dae("Radau")),
    "energy-momentum": lambda: only(solvers(), ["energy"]),
    "an integrator of one's own": own_solver,
    "counts of the work": counts,
    "statics, modes, linearisation": cantilever,
}
