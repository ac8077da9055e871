"""Published systems whose equations sympy derives, against DOP853 on minimal coordinates or closed forms."""

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from sympy.physics.mechanics import KanesMethod, LagrangesMethod, Particle, Point, ReferenceFrame, RigidBody, dynamicsymbols, inertia

import polyida as pi

t = dynamicsymbols._t
G = 9.81
NEAR = 1e-8


def radau(model, t_end, q0, v0=None, rtol=1e-11, **more):
    run = pi.solve(model, t_end, pi.RadauIIA(rtol=rtol), q0=q0, v0=v0, every=10**6, **more)
    assert run.success
    return run


def reference(accelerations, t_end, q0, v0):
    """q and v at the end of q'' = accelerations(t, q, v)."""
    n = len(q0)
    made = solve_ivp(
        lambda t, y: np.concatenate([y[n:], accelerations(t, y[:n], y[n:])]), (0.0, t_end), [*q0, *v0], "DOP853", rtol=1e-12, atol=1e-13
    )
    return made.y[:n, -1], made.y[n:, -1]


def pendulum_accelerations(n):
    """n points of 1 kg on rods of 1 m, angles from the vertical: sum over the points below."""
    below = n - np.maximum(*np.indices((n, n)))

    def accelerations(t, q, v):
        apart = q[:, None] - q[None]
        return np.linalg.solve(below * np.cos(apart), -(below * np.sin(apart)) @ v**2 - G * below.diagonal() * np.sin(q))

    return accelerations


def chain(n):
    """(Lagrangian, angles) of n points."""
    q, x, y, L = dynamicsymbols(f"q:{n}"), 0, 0, 0
    for one in q:
        x, y = x + sp.sin(one), y - sp.cos(one)
        L += (x.diff(t) ** 2 + y.diff(t) ** 2) / 2 - sp.Symbol("g") * y
    return L, q


@pytest.mark.parametrize("n", [2, 5])
def test_n_pendulum_in_angles(n):
    L, q = chain(n)
    q0 = np.linspace(1.0, 1.5, n)
    run = radau(pi.symbolic.lagrangian(L, q, values={sp.Symbol("g"): G}, compiled=False), 0.5, q0)
    exact = reference(pendulum_accelerations(n), 0.5, q0, np.zeros(n))
    assert np.abs(run.q[-1] - exact[0]).max() < NEAR and np.abs(run.v[-1] - exact[1]).max() < 10 * NEAR


def test_double_pendulum_in_places():
    places = dynamicsymbols("x1 y1 x2 y2")
    x1, y1, x2, y2 = places
    g = sp.Symbol("g")
    L = sum(one.diff(t) ** 2 for one in places) / 2 - g * (y1 + y2)
    model = pi.symbolic.lagrangian(
        L, places, phi=[sp.Eq(x1**2 + y1**2, 1), (x2 - x1) ** 2 + (y2 - y1) ** 2 - 1], values={g: G}, compiled=False
    )
    run = radau(model, 0.5, [np.sin(1.0), -np.cos(1.0), np.sin(1.0) + np.sin(1.5), -np.cos(1.0) - np.cos(1.5)])
    angles = reference(pendulum_accelerations(2), 0.5, [1.0, 1.5], np.zeros(2))[0]
    exact = np.cumsum(np.stack([np.sin(angles), -np.cos(angles)], axis=1), axis=0).ravel()
    assert np.abs(run.q[-1] - exact).max() < NEAR


def test_cart_pole_by_lagranges_method():
    """A cart with a motor force, a viscous brake and a pole: Barto, Sutton and Anderson (1983), a point at the pole's end."""
    x, a = dynamicsymbols("x theta")
    M, m, l, g, F, d = sp.symbols("M m l g F d")
    N, cart, pole = ReferenceFrame("N"), Point("C"), Point("P")
    cart.set_vel(N, x.diff(t) * N.x)
    pole.set_vel(N, (x.diff(t) + l * a.diff(t) * sp.cos(a)) * N.x - l * a.diff(t) * sp.sin(a) * N.y)
    bodies = Particle("cart", cart, M), Particle("pole", pole, m)
    bodies[1].potential_energy = m * g * l * sp.cos(a)
    L = sum(one.kinetic_energy(N) - one.potential_energy for one in bodies)
    method = LagrangesMethod(L, [x, a], forcelist=[(cart, (F - d * x.diff(t)) * N.x)], frame=N)
    model = pi.symbolic.mechanics(method, values={M: 1.0, m: 0.3, l: 0.5, g: G, F: 2.0, d: 0.4}, compiled=False)

    def accelerations(t, q, v):
        s, c = np.sin(q[1]), np.cos(q[1])
        return np.linalg.solve([[1.3, 0.15 * c], [0.15 * c, 0.075]], [0.15 * s * v[1] ** 2 + 2.0 - 0.4 * v[0], 0.15 * G * s])

    run, exact = radau(model, 1.0, [0.0, 0.3]), reference(accelerations, 1.0, [0.0, 0.3], [0.0, 0.0])
    assert np.abs(run.q[-1] - exact[0]).max() < NEAR


def test_four_bar_loop():
    q = dynamicsymbols("q:3")
    lengths, m, g = (1.0, 2.0, 1.5), sp.Symbol("m"), sp.Symbol("g")
    x = y = L = 0
    for one, length in zip(q, map(sp.Rational, ("1", "2", "3/2"))):
        cx, cy = x + length * sp.cos(one) / 2, y + length * sp.sin(one) / 2
        x, y = x + length * sp.cos(one), y + length * sp.sin(one)
        L += m * length * (cx.diff(t) ** 2 + cy.diff(t) ** 2 + length**2 * one.diff(t) ** 2 / 12) / 2 - m * length * g * cy
    model = pi.symbolic.lagrangian(L, q, phi=[x - sp.Rational(11, 5), y], values={m: 1.0, g: G}, compiled=False)

    half, mass = np.array(lengths) / 2, np.array(lengths)
    ahead = np.array([[half[0], 0, 0], [2 * half[0], half[1], 0], [2 * half[0], 2 * half[1], half[2]]])  # of the centres, along each bar

    def closing(crank):
        """The other two angles, of the branch in which the loop is open upwards."""
        tip = np.exp(1j * crank)
        to = 2.2 - tip
        apart, along = abs(to), np.angle(to)
        bend = np.arccos((apart**2 + 4.0 - 2.25) / (4.0 * apart))
        second = along + bend
        return np.array([crank, second, np.angle(2.2 - tip - 2.0 * np.exp(1j * second))])

    def accelerations(t, crank, rate):
        angles = closing(crank[0])
        e, turned = np.exp(1j * angles), 1j * np.exp(1j * angles)
        columns = turned[1:] * mass[1:]
        others = lambda right: np.linalg.solve(np.array([columns.real, columns.imag]), [right.real, right.imag])  # noqa: E731
        K = np.array([1.0, *others(-turned[0] * mass[0])])
        bends = np.array([0.0, *others((e * mass) @ K**2)])
        speeds = ahead * turned  # of the centres, by the rates of the angles
        M = np.real(np.conj(speeds).T * mass @ speeds) + np.diag(mass**3 / 12)
        centripetal = np.real(np.conj(speeds).T * mass @ (-(ahead * e) @ K**2))
        weight = G * mass @ speeds.imag
        return [-(K @ (M @ bends + centripetal) * rate[0] ** 2 + K @ weight) / (K @ M @ K)]

    start = closing(1.0)
    run, exact = radau(model, 0.6, start), reference(accelerations, 0.6, [1.0], [0.0])
    assert np.abs(run.q[-1] - closing(exact[0][0])).max() < NEAR


def test_chaplygin_sleigh():
    """`v' = a w^2, (I + m a^2) w' = -m a v w`: Neimark and Fufaev, Dynamics of Nonholonomic Systems (1972)."""
    x, y, angle = dynamicsymbols("x y phi")
    m, inert, a = sp.symbols("m I a")
    cx, cy = x + a * sp.cos(angle), y + a * sp.sin(angle)
    L = m * (cx.diff(t) ** 2 + cy.diff(t) ** 2) / 2 + inert * angle.diff(t) ** 2 / 2
    blade = y.diff(t) * sp.cos(angle) - x.diff(t) * sp.sin(angle)
    model = pi.symbolic.lagrangian(L, [x, y, angle], psi=[blade], values={m: 2.0, inert: 0.3, a: 0.4}, compiled=False)

    def rates(t, z):
        x, y, angle, v, w = z
        return [v * np.cos(angle), v * np.sin(angle), w, 0.4 * w**2, -2.0 * 0.4 * v * w / (0.3 + 2.0 * 0.16)]

    exact = solve_ivp(rates, (0.0, 2.0), [0.0, 0.0, 0.2, 1.0, 1.5], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    run = radau(model, 2.0, [0.0, 0.0, 0.2], [np.cos(0.2), np.sin(0.2), 1.5])
    assert np.abs(run.q[-1] - exact[:3]).max() < NEAR


def test_knife_edge_on_a_slope():
    """A blade that turns evenly moves along a cycloid across the slope: Neimark and Fufaev."""
    x, y, angle = dynamicsymbols("x y phi")
    pull = sp.Symbol("pull")
    L = (x.diff(t) ** 2 + y.diff(t) ** 2 + angle.diff(t) ** 2) / 2 + pull * x
    method = LagrangesMethod(L, [x, y, angle], nonhol_coneqs=[y.diff(t) * sp.cos(angle) - x.diff(t) * sp.sin(angle)])
    model = pi.symbolic.mechanics(method, values={pull: 3.0}, compiled=False)
    end, w = 1.5, 2.0
    run = radau(model, end, [0.0, 0.0, 0.0], [0.0, 0.0, w])
    size, turn = 3.0 / (2 * w * w), w * end
    assert np.abs(run.q[-1] - [size * np.sin(turn) ** 2, size * (turn - np.sin(2 * turn) / 2), turn]).max() < NEAR


def test_bicycle_linearised_in_roll_and_steer():
    """The benchmark of Meijaard, Papadopoulos, Ruina and Schwab, Proc. R. Soc. A 463 (2007): its matrices and, at 5 m/s, its eigenvalues."""
    q, v = dynamicsymbols("roll steer"), sp.Symbol("v")
    M = sp.Matrix([[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]])
    C1 = sp.Matrix([[0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]])
    K0 = sp.Matrix([[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]])
    K2 = sp.Matrix([[0, 76.59734589573222], [0, 2.65431523794604]])
    places = sp.Matrix(q)
    g = v * C1 * places.diff(t) + (sp.Float("9.81") * K0 + v**2 * K2) * places
    model = pi.symbolic.equations(M, list(g), q, values={v: 5.0}, compiled=False)
    start = np.array([0.01, -0.02, 0.1, 0.0])
    published = -14.07838969279822, -0.32286642900409, -0.77534188219585 + 4.46486771378823j, -0.77534188219585 - 4.46486771378823j
    zero = np.zeros(2)
    slopes = [-np.linalg.solve(model.mass(zero), one) for one in (model.force_q(0.0, zero, zero), model.force_v(0.0, zero, zero))]
    A = np.block([[np.zeros((2, 2)), np.eye(2)], slopes])
    assert np.abs(np.sort_complex(np.linalg.eigvals(A)) - np.sort_complex(published)).max() < 1e-9
    run = radau(model, 1.0, start[:2], start[2:])
    assert np.abs(np.append(run.q[-1], run.v[-1]) - expm(A) @ start).max() < NEAR


def test_spherical_pendulum():
    places = dynamicsymbols("x y z")
    g, l = sp.symbols("g l")
    L = sum(one.diff(t) ** 2 for one in places) / 2 - g * places[2]
    model = pi.symbolic.lagrangian(L, places, phi=[sum(one**2 for one in places) - l**2], values={g: G, l: 1.5}, compiled=False)

    def accelerations(t, q, v):
        return [np.sin(q[0]) * np.cos(q[0]) * v[1] ** 2 - G / 1.5 * np.sin(q[0]), -2.0 * v[0] * v[1] / np.tan(q[0])]

    exact = reference(accelerations, 1.0, [0.8, 0.0], [0.0, 1.2])[0]
    place = lambda a, b: 1.5 * np.array([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), -np.cos(a)])  # noqa: E731
    run = radau(model, 1.0, place(0.8, 0.0), [0.0, 1.5 * np.sin(0.8) * 1.2, 0.0])
    assert np.abs(run.q[-1] - place(*exact)).max() < NEAR


def rolling_disc():
    """(KanesMethod, frame) of sympy's documentation: a disc of 1 kg and 0.5 m that rolls; yaw, lean and spin."""
    q, u = dynamicsymbols("q1 q2 q3"), dynamicsymbols("u1 u2 u3")
    r, m, g = sp.symbols("r m g")
    N = ReferenceFrame("N")
    Y = N.orientnew("Y", "Axis", [q[0], N.z])
    lean = Y.orientnew("L", "Axis", [q[1], Y.x])
    disc = lean.orientnew("R", "Axis", [q[2], lean.y])
    w = disc.ang_vel_in(N)
    kinematic = [w.dot(axis) - one for axis, one in zip((lean.x, lean.y, lean.z), u)]
    disc.set_ang_vel(N, sum((one * axis for axis, one in zip((lean.x, lean.y, lean.z), u)), 0 * lean.x))
    contact = Point("C")
    contact.set_vel(N, 0)
    centre = contact.locatenew("D", r * lean.z)
    centre.v2pt_theory(contact, N, disc)
    body = RigidBody("disc", centre, disc, m, (inertia(lean, m / 4 * r**2, m / 2 * r**2, m / 4 * r**2), centre))
    kane = KanesMethod(N, q_ind=q, u_ind=u, kd_eqs=kinematic)
    kane.kanes_equations([body], [(centre, -m * g * Y.z)])
    return kane, dict(zip((r, m, g), (0.5, 1.0, G)))


def test_rolling_disc_in_space():
    kane, values = rolling_disc()
    rates = sp.lambdify([[*kane.q, *kane.u]], kane.rhs().subs(values))
    start = np.array([0.1, 0.3, 0.0, 0.2, 4.0, 0.5])
    exact = solve_ivp(lambda t, y: rates(y)[:, 0], (0.0, 0.5), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    model = pi.symbolic.mechanics(kane, values=values, compiled=False)
    slopes = kane.kindiffdict()
    v0 = [float(slopes[one.diff(t)].subs(dict(zip([*kane.q, *kane.u], start)))) for one in kane.q]
    run = radau(model, 0.5, start[:3], v0)
    assert np.abs(run.q[-1] - exact[:3]).max() < NEAR
    assert np.abs(model.evaluate(run, list(kane.u))[-1] - exact[3:]).max() < 10 * NEAR


def test_furuta_pendulum():
    """An arm of 0.3 m with inertia 0.02 kg m2 and a pole of 0.1 kg, a point at 0.4 m: Cazzolato and Prime (2011)."""
    arm, pole = dynamicsymbols("theta alpha")
    J, m, R, l, g, tau = sp.symbols("J m R l g tau")
    x = R * sp.cos(arm) - l * sp.sin(pole) * sp.sin(arm)
    y = R * sp.sin(arm) + l * sp.sin(pole) * sp.cos(arm)
    z = -l * sp.cos(pole)
    L = J * arm.diff(t) ** 2 / 2 + m * sum(one.diff(t) ** 2 for one in (x, y, z)) / 2 - m * g * z
    values = {J: 0.02, m: 0.1, R: 0.3, l: 0.4, g: G, tau: 0.05}
    model = pi.symbolic.lagrangian(L, [arm, pole], forces=[tau, 0], values=values, compiled=False)

    def accelerations(t, q, v):
        s, c, m, R, l = np.sin(q[1]), np.cos(q[1]), 0.1, 0.3, 0.4
        M = [[0.02 + m * (R * R + l * l * s * s), m * R * l * c], [m * R * l * c, m * l * l]]
        turning = 0.05 - 2 * m * l * l * s * c * v[0] * v[1] + m * R * l * s * v[1] ** 2
        return np.linalg.solve(M, [turning, m * l * l * s * c * v[0] ** 2 - m * G * l * s])

    run, exact = radau(model, 1.0, [0.0, 1.2], [2.0, 0.0]), reference(accelerations, 1.0, [0.0, 1.2], [2.0, 0.0])
    assert np.abs(run.q[-1] - exact[0]).max() < NEAR
