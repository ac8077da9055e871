"""Wrong input of pi.symbolic: an error before the run that has the expression."""

import sys

import pytest
import sympy as sp
from sympy.physics.mechanics import KanesMethod, LagrangesMethod, ReferenceFrame, dynamicsymbols

import polyida as pi

t = dynamicsymbols._t
x, y, f = dynamicsymbols("x y f")
m, g, l, k = sp.symbols("m g l k")
T = m * (x.diff(t) ** 2 + y.diff(t) ** 2) / 2
L = T - m * g * y
V = {m: 1.0, g: 9.81}
LENGTH = V | {l: 1.0}
CASES = {  # name: (arguments, what the message has)
    "a value is missing": (dict(L=L, q=[x, y], values={m: 1.0}), r"L = .*: g has no value"),
    "a value in phi is missing": (dict(L=L, q=[x, y], phi=[x**2 - l**2], values=V), r"phi\[0\] = -l\*\*2 .*l has no value"),
    "a value is not used": (dict(L=L, q=[x, y], values=V | {k: 1.0}), "values has k"),
    "other assumptions": (
        dict(L=L, q=[x, y], values={m: 1.0, sp.Symbol("g", positive=True): 1.0}),
        "g has no value; values has a symbol g",
    ),
    "a value is no number": (dict(L=L, q=[x, y], values=V | {m: "one"}), r"values\[m\] = 'one'"),
    "a profile for a symbol": (dict(L=L, q=[x, y], values=V | {m: pi.profile.constant(1.0)}), r"values\[m\]"),
    "velocity in phi": (dict(L=L, q=[x, y], phi=[x.diff(t) - y], values=V), r"phi\[0\] = .*velocities; .*psi"),
    "acceleration in L": (dict(L=L + x.diff(t, 2) * x, q=[x, y], values=V), "L = .*no accelerations"),
    "no coordinate in phi": (dict(L=L, q=[x, y], phi=[l - 1], values=LENGTH), r"phi\[0\] = l - 1: it has no coordinate"),
    "no velocity in psi": (dict(L=L, q=[x, y], psi=[x - 1], values=V), r"psi\[0\] = x\(t\) - 1: it has no velocity"),
    "psi is not linear": (dict(L=L, q=[x, y], psi=[x.diff(t) ** 2 - 1], values=V), r"psi\[0\] = .*linear in the velocities"),
    "psi with a root": (dict(L=L, q=[x, y], psi=[sp.sqrt(x.diff(t)) - y], values=V), r"psi\[0\] = .*linear"),
    "L is not quadratic": (dict(L=L + x.diff(t) ** 4, q=[x, y], values=V), "L = .*quadratic in the velocities"),
    "no numpy name": (dict(L=L - sp.besselj(0, x), q=[x, y], values=V), r"L = .*besselj"),
    "an unknown function": (dict(L=L - sp.Function("h")(x), q=[x, y], values=V), r"L = .*h\(x\(t\)\) is a function that is not known"),
    "a function of time without a value": (dict(L=L + f * x, q=[x, y], values=V), r"L = .*f\(t\) is no coordinate.*give it in values"),
    "a third derivative": (
        dict(L=L, q=[x, y], phi=[x - f.diff(t)], values=V | {f: pi.profile.sine(1.0, 1.0)}),
        r"third derivative of f\(t\)",
    ),
    "mass that depends on time": (dict(L=L + t * x.diff(t) ** 2, q=[x, y], values=V), r"mass matrix of x\(t\) depends on t.*coordinate s"),
    "a state in phi": (dict(L=L, q=[x, y], phi=[x - f], states={f: -f}, values=V), r"phi\[0\] = .*no states"),
    "forces of the wrong length": (dict(L=L, q=[x, y], forces=[x], values=V), "forces has 1 entries"),
    "complex": (dict(L=L + sp.I * x, q=[x, y], values=V), "L = .*real"),
    "a matrix for L": (dict(L=sp.Matrix([L, L]), q=[x, y], values=V), "L = .*expression"),
    "one expression for phi": (dict(L=L, q=[x, y], phi=x - y, values=V), "phi = .*list of expressions"),
    "text": (dict(L="m*x", q=[x, y], values=V), "L = 'm"),
    "a coordinate twice": (dict(L=L, q=[x, x], values=V), "twice"),
    "a symbol as coordinate": (dict(L=L, q=[x, m], values=V), r"q\[1\] = m must be a function of time"),
    "no coordinates": (dict(L=L, q=[], values=V), "a coordinate at least"),
    "values of no kind": (dict(L=L, q=[x, y], values=[1.0, 9.81]), "values = .*dictionary"),
    "compiled": (dict(L=L, q=[x, y], values=V, compiled=2), "compiled = 2"),
}


@pytest.mark.parametrize("case", CASES)
def test_wrong_lagrangian(case):
    arguments, words = CASES[case]
    with pytest.raises(pi.InputError, match=words):
        pi.symbolic.lagrangian(**arguments)


def test_coordinate_that_nothing_holds_is_named():
    z = dynamicsymbols("z")
    model = pi.symbolic.lagrangian(L - z**2, [x, y, z], values=V, compiled=False)
    with pytest.raises(pi.InputError, match=r"singular on the constraints, where nothing holds z\(t\)"):
        pi.solve(model, 0.1, pi.GeneralizedAlpha(h=1e-2))
    held = pi.symbolic.lagrangian(L - z**2, [x, y, z], phi=[z - x], values=V, compiled=False)
    assert pi.solve(held, 0.1, pi.GeneralizedAlpha(h=1e-2)).success


@pytest.mark.parametrize(
    "change, words",
    [
        (dict(M=[[m, 0]]), r"shape \(1, 2\)"),
        (dict(M=[[m, 0], [0, m * t]]), r"mass matrix of y\(t\) depends on t"),
        (dict(M=[[m, 0], [0, m * y.diff(t)]]), r"M\[1, 1\] = .*no velocities"),
        (dict(g=[0]), "g 1 entries"),
        (dict(potential=g * y * t), "potential = .*q alone"),
    ],
)
def test_wrong_equations(change, words):
    arguments = dict(M=[[m, 0], [0, m]], g=[0, m * g], q=[x, y], values=V) | change
    with pytest.raises(pi.InputError, match=words):
        pi.symbolic.equations(**arguments)


def test_mass_that_is_not_symmetric_is_refused():
    model = pi.symbolic.equations([[1, x], [0, 1]], [0, 0], [x, y], compiled=False)
    with pytest.raises(pi.InputError, match="symmetric"):
        pi.solve(model, 0.1, pi.GeneralizedAlpha(h=1e-2), q0=[1.0, 0.0])


def test_wrong_methods():
    u, w = dynamicsymbols("u w")
    N = ReferenceFrame("N")
    with pytest.raises(pi.InputError, match="LagrangesMethod or a KanesMethod"):
        pi.symbolic.mechanics(L, values=V)
    with pytest.raises(pi.InputError, match=r"kanes_equations\(bodies, loads\)"):
        pi.symbolic.mechanics(KanesMethod(N, q_ind=[x], u_ind=[u], kd_eqs=[u - x.diff(t)]), values=V)
    method = LagrangesMethod(L, [x, y], forcelist=[(N, N.x)])
    with pytest.raises(pi.InputError, match="no frame"):
        pi.symbolic.mechanics(method, values=V)


def test_without_sympy(monkeypatch):
    monkeypatch.setitem(sys.modules, "sympy", None)
    with pytest.raises(pi.InputError, match=r"pip install 'polyida\[symbolic\]'"):
        pi.symbolic.lagrangian(L, [x, y], values=V)
