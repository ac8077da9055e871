"""Models from the methods of sympy.physics.mechanics."""

import sympy as sp
from sympy.core.function import AppliedUndef
from sympy.physics.mechanics import KanesMethod, LagrangesMethod, Point, dynamicsymbols

from polyida.errors import InputError
from polyida.symbolic import systems
from polyida.symbolic.derivatives import Derivative, jacobian

PART = "symbolic.mechanics"


def mechanics(method, values, compiled):
    """The SymbolicModel of a LagrangesMethod or KanesMethod of sympy, with {symbol: value}; compiled: True for machine code."""
    for inner in ("eom_method", "method"):  # of a System and of a JointsMethod
        if (found := getattr(method, inner, None)) is not None and not isinstance(method, (KanesMethod, LagrangesMethod)):
            method = found
    if isinstance(method, LagrangesMethod):
        return _of_lagrange(method, values, compiled)
    if isinstance(method, KanesMethod):
        return _of_kane(method, values, compiled)
    raise InputError(f"{PART}: {method!r:.80} must be a LagrangesMethod or a KanesMethod of sympy.physics.mechanics")


def _of_lagrange(method, values, compiled):
    """The model of a LagrangesMethod, from its Lagrangian, constraints and loads."""
    q, holonomic = list(method.q), list(method._hol_coneqs)
    psi, also = list(method.coneqs)[len(holonomic) :], {}
    lam = sp.symbols(f"lam:{len(holonomic) + len(psi)}", real=True)
    if method.lam_vec:
        also = dict(zip(method.lam_vec, lam))
    forces = _generalised(method) if method.forcelist else []
    return systems.lagrangian(method._L[0], q, holonomic, psi, forces, None, values, compiled, PART, also)


def _generalised(method):
    """The generalised forces of the loads: each times the slope of the velocity of where it acts."""
    frame, rates = method.inertial, method.q.diff(dynamicsymbols._t)
    if frame is None:
        raise InputError(f"{PART}: the LagrangesMethod has a forcelist, but no frame: give LagrangesMethod(..., frame=N)")
    moving = [(place.vel(frame) if isinstance(place, Point) else place.ang_vel_in(frame), force) for place, force in method.forcelist]
    return [sum(velocity.diff(rate, frame, var_in_dcm=False).dot(force) for velocity, force in moving) for rate in rates]


def _of_kane(method, values, compiled):
    """The model of a KanesMethod: its equations in the speeds u = W(q) q' + w, put back to q'."""
    if method._frstar is None:
        raise InputError(f"{PART}: the KanesMethod has no equations yet: call its kanes_equations(bodies, loads) before")
    q, u = list(method.q), list(method.u)
    if len(u) != len(q):
        raise InputError(
            f"{PART}: {len(u)} speeds of {len(q)} coordinates: give one speed for each coordinate, those that a constraint ties "
            "as u_dependent, with velocity_constraints"
        )
    t, rates = dynamicsymbols._t, [one.diff(dynamicsymbols._t) for one in q]
    speeds = _speeds(method, u, rates)
    in_rates, holonomic = dict(zip(u, speeds)), list(method._f_h)
    psi = [one.xreplace(in_rates) for one in method._k_nh * method.u + method._f_nh] if method._udep else []
    if method._udep:
        method = _of_all_speeds(method, q, u)
    W = sp.Matrix(jacobian(speeds, rates))
    free = sp.Matrix([speed.xreplace(dict.fromkeys(rates, sp.S.Zero)) for speed in speeds])
    moving = W.atoms(AppliedUndef, sp.Derivative) | free.atoms(AppliedUndef, sp.Derivative)
    turning = Derivative({t: sp.S.One} | {one: one.diff(t) for one in moving})
    drift = [sp.Add(*(turning(slope) * rate for slope, rate in zip(W.row(i), rates)), turning(free[i])) for i in range(len(u))]
    M, forcing = method.mass_matrix.xreplace(in_rates), method.forcing.xreplace(in_rates)
    mass, force = M * W, M * sp.Matrix(drift) - forcing
    return systems.equations(W.T * mass, W.T * force, q, holonomic, psi, None, values, None, compiled, PART, in_rates)


def _speeds(method, u, rates):
    """A list of expressions: the speeds u in terms of `rates` = q', from the kinematic equations `k_ku u + k_kqdot q' + f_k = 0`.

    method: a KanesMethod, which has these equations. u: its speeds.
    """
    k_ku, others = method._k_ku_implicit, method._k_kqdot_implicit * sp.Matrix(rates) + method._f_k_implicit
    if k_ku.is_diagonal():
        return [-one / k_ku[k, k] for k, one in enumerate(others)]
    return list(-k_ku.LUsolve(others))


def _of_all_speeds(method, q, u):
    """The KanesMethod with all speeds independent: its constraints act by multipliers."""
    kinematic = [rate - one for rate, one in method.kindiffdict().items()]
    free = KanesMethod(method._inertial, q, u, kinematic, u_auxiliary=list(method._uaux) or None)
    try:
        free.kanes_equations(method.bodies, method.forcelist)
    except (TypeError, ValueError, AttributeError) as error:
        what = f"its dependent speeds are eliminated, and equations of all speeds cannot be formed ({error})"
        raise InputError(
            f"{PART}: {what}: give a KanesMethod with all speeds in u_ind, or symbolic.equations(M, g, q, psi=...) with its rows"
        ) from None
    return free
