"""References of the scenes with contact and friction: closed forms, digits, and DOP853 between located events."""

import numpy as np
from scipy.integrate import solve_ivp

from nonsmooth.scenes import ANGLE, CRANK, HIGH, LEANS, MASSES, ROD, SPIN, WIDE, Belt, G

PENDULUM = -0.119172717  # rad, of the pendulum at 3 s from 1 rad; DOP853 between its two reversals
PENDULUM_STICKS = 0.00383  # rad, where it sticks from 0.1 rad


def belt(t):
    """Place of the block on the belt at times, m."""
    t = np.asarray(t, float)
    sticking = 3.0 - 3.0 * np.cos(Belt.sticks) + t - Belt.sticks
    return np.where(t < Belt.sticks, 3.0 - 3.0 * np.cos(t), np.where(t < Belt.slips, sticking, 3.0 + np.sin(t - Belt.slips)))


def bounces(t, e, g=G, height=1.0):
    """Height at t of a ball that falls from rest, and the number of its impacts; 0 and infinity behind the end of the bounces."""
    if e < 1.0 and t >= rest_of_bounces(e, g, height):
        return 0.0, np.inf
    at, v, count = np.sqrt(2 * height / g), np.sqrt(2 * height * g), 0
    if t < at:
        return height - 0.5 * g * t * t, 0
    while True:
        v, count = e * v, count + 1
        if t < at + 2 * v / g:
            return v * (t - at) - 0.5 * g * (t - at) ** 2, count
        at += 2 * v / g


def rest_of_bounces(e, g=G, height=1.0):
    """Time at which the bounces of a ball from rest end, s."""
    return np.sqrt(2 * height / g) * (1 + e) / (1 - e)


def balls(t):
    """Places (2, times) of the two balls, m."""
    after = np.maximum(np.asarray(t, float) - 0.32, 0.0)
    return np.array([np.minimum(t, 0.32), 0.52 + after])


def rocking(t_end):
    """Angle of the rocking block at t_end, rad, positive on the left corner; Housner's ratio of the rates at an impact.

    Housner, Bull. Seismol. Soc. Am. 53 (1963) 403-417.
    """
    R, alpha = np.hypot(WIDE, HIGH), np.arctan(WIDE / HIGH)
    ratio = 1.0 - 1.5 * np.sin(alpha) ** 2
    t, y, side = 0.0, np.array([LEANS, 0.0]), 1.0
    while True:
        flat = lambda t, y: y[0]  # noqa: E731
        flat.terminal, flat.direction = True, -side
        fall = lambda t, y, side=side: [y[1], -0.75 * G / R * np.sin(alpha * side - y[0])]  # noqa: E731
        run = solve_ivp(fall, (t, t_end), y, "DOP853", rtol=1e-12, atol=1e-14, events=flat)
        t, y = run.t[-1], run.y[:, -1]
        if run.status == 0:
            return y[0]
        y, side = np.array([0.0, ratio * y[1]]), -side
        t, y = t + 1e-12, y + 1e-12 * np.array([y[1], 0.0])


def _until_a_zero(forces, slip, t, y, t_end):
    """DOP853 from (t, y) to the next zero of the slip's rate or of the guide's force."""
    turn, lift = (lambda t, y: forces(y, slip)[2]), (lambda t, y: forces(y, slip)[1])
    turn.terminal = lift.terminal = True
    turn.direction = -slip
    tight = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
    return solve_ivp(lambda t, y: [y[1], forces(y, slip)[0]], (t, t_end), y, events=[turn, lift], **tight)


def crank_angle(mu, t_end):
    """Angle and rate of the slider-crank's crank at t_end: DOP853 on one coordinate, restarted where the slip or the guide's force changes sign."""
    (m1, m2, m3), r, l = MASSES, CRANK, ROD  # noqa: E741

    def forces(y, slip):
        """(acceleration, N): from the unknowns (th'', B_x, B_y, N), B the force of the slider on the rod."""
        th, w = y
        be = -np.arcsin(r / l * np.sin(th))
        s, c, sb, cb = np.sin(th), np.cos(th), np.sin(be), np.cos(be)
        b1 = -r * c / (l * cb)
        b0 = (r * s * w * w + l * sb * (b1 * w) ** 2) / (l * cb)
        # accelerations (coefficient of th'', rest)
        x1, x0 = -r * s - l * sb * b1, -r * c * w * w - l * sb * b0 - l * cb * (b1 * w) ** 2
        cx1, cx0 = -r * s - l / 2 * sb * b1, -r * c * w * w - l / 2 * (sb * b0 + cb * (b1 * w) ** 2)
        cy1, cy0 = r * c + l / 2 * cb * b1, -r * s * w * w + l / 2 * (cb * b0 - sb * (b1 * w) ** 2)
        inertia, dx, dy = m2 * l * l / 12, l / 2 * cb, l / 2 * sb
        n_sign = 1.0
        for _ in range(3):
            friction = -slip * mu * n_sign  # of N
            A = np.array(
                [
                    [m3 * x1, 1.0, 0.0, -friction],  # slider along the guide
                    [0.0, 0.0, 1.0, -1.0],  # and across: N = m3 g + B_y
                    # rod about its end at the crank
                    [inertia * b1 + dx * m2 * cy1 - dy * m2 * cx1, 2 * dy, -2 * dx, 0.0],
                    # crank about the bearing: the rod's equations give the force at the pin
                    [m1 * r * r / 3 + m2 * (r * c * cy1 - r * s * cx1), r * s, -r * c, 0.0],
                ]
            )
            rest = [-m3 * x0, -m3 * G, -inertia * b0 - dx * m2 * (cy0 + G) + dy * m2 * cx0, 0.0]
            rest[3] = -m1 * G * r / 2 * c - m2 * (r * c * (cy0 + G) - r * s * cx0)
            a, _, _, N = np.linalg.solve(A, rest)
            if np.sign(N) == n_sign:
                break
            n_sign = np.sign(N)
        return a, N, x1 * w

    t, y = 0.0, np.array([ANGLE, SPIN])
    slip = np.sign(forces(y, 1.0)[2])
    while True:
        run = _until_a_zero(forces, slip, t, y, t_end)
        t, y = run.t[-1], run.y[:, -1]
        if run.status == 0:
            return y
        slip = -slip if run.t_events[0].size else slip
        t, y = t + 1e-9, y + 1e-9 * np.array([y[1], forces(y, slip)[0]])  # beyond the zero that was located


def place_of_slider(angle):
    return CRANK * np.cos(angle) + np.sqrt(ROD**2 - (CRANK * np.sin(angle)) ** 2)


def slips_of_rod(angle, spin, speed, mu=5 / 3):
    """({what ends a slip of the sliding rod: time, s}, run of the last slip): "slips" to the other side, "opens", or "singular".

    DOP853 on angle, rate, slip and t over `dt = D d tau`, in which the motion is smooth: the force of the contact is N / D. The ground holds
    the tip in both directions until N = 0.
    """
    ends, y, tight = {}, [angle, spin, speed, 0.0], {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14, "dense_output": True}
    while True:
        sign = np.sign(speed)

        def forces(y, sign=sign):
            """(D, N, spin' D / N)."""
            s, c = np.sin(y[0]), np.cos(y[0])
            turn = -3.0 * (c + sign * mu * s)
            return 1.0 - c * turn, 10.0 - s * y[1] ** 2, turn

        def slope(tau, y, sign=sign, forces=forces):
            D, N, turn = forces(y)
            s, c = np.sin(y[0]), np.cos(y[0])
            return [y[1] * D, turn * N, (s * turn - sign * mu) * N + c * y[1] ** 2 * D, D]

        reverses, opens, singular = (lambda tau, y: y[2]), (lambda tau, y, f=forces: f(y)[1]), (lambda tau, y, f=forces: f(y)[0] - 1e-9)
        reverses.terminal = opens.terminal = singular.terminal = True
        run = solve_ivp(slope, (0.0, 1e3), y, events=[reverses, opens, singular], **tight)
        what = ("slips", "opens", "singular")[[len(times) for times in run.t_events].index(1)]
        ends[what], speed, y = float(run.y[3, -1]), -speed, run.y[:, -1] * [1.0, 1.0, 0.0, 1.0]
        if what != "slips":
            return ends, run
        y[2] = -1e-12 * sign
