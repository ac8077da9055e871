"""Reverse accumulation: vectors on a tape, and a model whose functions take such vectors, so that a method's own code is differentiated.

The vector-Jacobian products of the model's functions come from its own derivatives. For the slopes in parameters, `entries` gets the
multipliers of r, phi, its rate and its bias in each state (AdjointMultipliers).
"""

import numpy as np

from polyida.adjoint.parameter import AdjointMultipliers
from polyida.integrate.alpha.start import resolution
from polyida.integrate.start import on_position, start_values, velocity_rate
from polyida.integrate.state import Counts
from polyida.linear.saddle import ExactSaddle
from polyida.model.differences import along, central


class Tape:
    """Records of operations in order; `back` processes them in reverse."""

    def __init__(self):
        """Make an empty tape, `records` = []; each record of an operation will be the pair (results, function back)."""
        self.records = []

    def var(self, value):
        """A vector or number on the tape with this value, which depends on nothing before it."""
        return Var(self, np.array(value, float))

    def record(self, values, back):
        """Vectors with these values, computed together; back takes all their adjoints and adds to those of the arguments."""
        results = [self.var(value) for value in values]
        self.records.append((results, back))
        return results

    def back(self, again=False):
        """Propagate all adjoints. Those of results of operations are zero afterwards. again: True if others follow; else the tape is empty
        afterwards and holds no reference to a model.
        """
        for results, back in reversed(self.records):
            adjoints = [var.adjoint for var in results]
            for var in results:
                var.adjoint = np.zeros_like(var.value)
            if any(adjoint.any() for adjoint in adjoints):
                back(*adjoints)
        if not again:
            self.records = []


class Var:
    """A vector on a tape: value, and adjoint, the slope of the objective in it. It can be added to numbers and arrays."""

    __array_ufunc__ = None  # numpy leaves sums and products to this class

    def __init__(self, tape, value):
        """Put a value, an array or a number, on a tape, with a zero adjoint."""
        self.tape, self.value = tape, value
        self.adjoint = np.zeros_like(value)

    def _sum(self, value, *terms):
        """The vector with this value, a sum of terms (vector, factor)."""

        def back(adjoint):
            """Add the adjoint of the sum, times its factor, to each term."""
            for thing, factor in terms:
                add_to(thing, factor * adjoint)

        return self.tape.record([value], back)[0]

    def __add__(self, other):
        """The sum with a vector on the tape, an array or a number."""
        return self._sum(self.value + value_of(other), (self, 1.0), (other, 1.0))

    def __sub__(self, other):
        """The difference to a vector on the tape, an array or a number."""
        return self._sum(self.value - value_of(other), (self, 1.0), (other, -1.0))

    def __rsub__(self, other):
        """An array or a number less this vector, on the tape."""
        return self._sum(other - self.value, (self, -1.0))

    def __mul__(self, factor):
        """The product with a number or an array, or with a vector or a number on the tape."""
        if not isinstance(factor, Var):
            return self._sum(factor * self.value, (self, factor))

        def back(adjoint):
            """Add the adjoint times the other factor to each factor, summed if that is a number."""
            for one, other in ((self, factor), (factor, self)):
                product = other.value * adjoint
                add_to(one, product if np.ndim(one.value) else np.sum(product))

        return self.tape.record([self.value * factor.value], back)[0]

    def __truediv__(self, divisor):
        """The divisor may be a number on the tape; this vector is a number then, too."""
        if not isinstance(divisor, Var):
            return self * (1.0 / divisor)

        def back(adjoint):
            """Add the adjoint times `1/divisor` to this number and times `-value/divisor^2` to the divisor."""
            add_to(self, adjoint / divisor.value)
            add_to(divisor, -adjoint * self.value / divisor.value**2)

        return self.tape.record([self.value / divisor.value], back)[0]

    def __matmul__(self, other):
        """The scalar product with a vector on the tape."""

        def back(adjoint):
            """Add the adjoint, a number, times the other vector to each of the two vectors."""
            add_to(self, adjoint * other.value)
            add_to(other, adjoint * self.value)

        return self.tape.record([self.value @ other.value], back)[0]

    def __gt__(self, other):
        """Compare the value with a number; the tape records nothing."""
        return bool(self.value > other)

    def __neg__(self):
        """The negative of the vector, on the tape."""
        return self * -1.0

    def any(self):
        """True: code must not skip a vector because it is zero now."""
        return True

    __radd__, __rmul__ = __add__, __mul__


def value_of(thing):
    """The value of a Var; anything else as it is."""
    return thing.value if isinstance(thing, Var) else thing


def add_to(thing, adjoint):
    """Add to the adjoint of a Var; no effect on anything else."""
    if isinstance(thing, Var):
        thing.adjoint = thing.adjoint + adjoint


class TapedModel:
    """A model whose functions take vectors on a tape."""

    is_scene = False  # it gives no dense phi_q

    def __init__(self, model, tape):
        """Take what a method asks of a model beside its functions."""
        self.model, self.tape = model, tape
        self.entries = []
        self.n, self.m, self.needs, self.kinks, self.velocity_rows = model.n, model.m, model.needs, model.kinks, model.velocity_rows
        self._none = np.zeros(self.n), np.zeros(self.m)

    def sampled(self, t, q, v):
        """v: a model with controllers has no gradient."""
        return v

    def add_entry(self, t, q, v=None, a=None, lam=None, w=None, **more):
        """Add multipliers for the parameters' slopes."""
        zero, rows = self._none
        vectors = [zero if x is None else value_of(x) for x in (v, a)]
        lam, w = (none if x is None else value_of(x) for x, none in ((lam, rows), (w, zero)))
        self.entries.append(AdjointMultipliers(t, value_of(q), *vectors, lam, w, *(more.get(name, rows) for name in ("mu", "kappa", "nu"))))

    def force(self, t, q, v):
        """The force g, (n,), on the tape; its derivatives are force_q and force_v."""

        def back(adjoint):
            """Add the transposed derivatives of g times its adjoint (n,) to the adjoints of q and v, and it to `entries`."""
            at = t, value_of(q), value_of(v)
            add_to(q, residual_q(self.model, *at, *self._none, adjoint))
            if self.needs.velocity_forces:
                add_to(v, residual_v(self.model, *at, adjoint))
            self.add_entry(t, q, v, w=adjoint)

        return self.tape.record([self.model.force(t, value_of(q), value_of(v))], back)[0]

    def phi_rate(self, t, q, v):
        """The rate of the constraints, `phi_q v + phi_t`, (m,)."""

        def back(kappa):
            """Add the transposed derivatives of the rate times its adjoint kappa (m,) to the adjoints of q and v.

            kappa is added to the entries for parameters.
            """
            at = t, value_of(q)
            add_to(q, self.model.phi_rate_q(*at, value_of(v)).T @ kappa)
            add_to(v, self.model.phi_q(*at).T @ kappa)
            self.add_entry(t, q, v, kappa=kappa)

        return self.tape.record([self.model.phi_rate(t, value_of(q), value_of(v))], back)[0]

    def phi_t(self, t, q):
        """The partial derivative of phi in time, (m,), on the tape: the rate at v = 0."""
        return self.phi_rate(t, q, self._none[0])

    def phi_bias(self, t, q, v):
        """The part of phi'' without accelerations, `(phi_q v)_q v + 2 phi_qt v + phi_tt`, (m,), on the tape."""

        def back(nu):
            """Add the transposed derivatives of the bias times its adjoint nu (m,) to the adjoints of q and v.

            nu is added to the entries for parameters.
            """
            at = t, value_of(q), value_of(v)
            if self.needs.driven or self.needs.phi_q_varies:
                add_to(q, self.model.phi_bias_q(*at).T @ nu)
                add_to(v, self.model.phi_bias_v(*at).T @ nu)
            self.add_entry(t, q, v, nu=nu)

        return self.tape.record([self.model.phi_bias(t, value_of(q), value_of(v))], back)[0]

    def phi_q(self, t, q):
        """An object that stands for B = phi_q at (t, q): its products with vectors are recorded on the tape."""
        return _Rows(self, t, q)

    def mass_system(self, t, q):
        """The system `[[M, B^T], [B, 0]]` at (t, q), for solves on the tape."""
        return _MassSystem(self, t, q)


def pulled_back(model, state, function, adjoints):
    """(adjoint of q, adjoint of v, entries for parameters) at a state, from the adjoints of the results of function(model, q, v); None for
    zero.
    """
    tape = Tape()
    taped, q, v = TapedModel(model, tape), tape.var(state.q), tape.var(state.v)
    for result, adjoint in zip(function(taped, q, v), adjoints):
        if adjoint is not None:
            add_to(result, adjoint)
    tape.back()
    return q.adjoint, v.adjoint, taped.entries


class _Rows:
    """B = phi_q of a TapedModel at (t, q), for products with vectors."""

    def __init__(self, taped, t, q):
        """Take a TapedModel, the time, and q, which may be on the tape: B = phi_q there."""
        self.taped, self.t, self.q = taped, t, q

    def __matmul__(self, x):
        """The product B x with a vector x, on the tape or not."""
        taped, model, t, q = self.taped, self.taped.model, self.t, value_of(self.q)

        def back(nu):
            """Add the products of the derivatives of B x with nu, its adjoint."""
            add_to(self.q, reaction_transposed(model, t, q, nu, value_of(x)))
            add_to(x, model.phi_q(t, q).T @ nu)
            taped.add_entry(t, q, x, kappa=nu)
            taped.add_entry(t, q, kappa=-nu)

        return taped.tape.record([model.phi_q(t, q) @ value_of(x)], back)[0]


class _MassSystem:
    """`M dq + B^T dlam = -r`, `B dq = -phi`, which is symmetric."""

    def __init__(self, taped, t, q):
        """Take a TapedModel, and factor the system at (t, q); q may be on the tape."""
        self.taped, self.t, self.q = taped, t, q
        self.system = taped.model.mass_system(t, value_of(q))

    def solve(self, r, phi):
        """(dq, dlam) of the residuals r and phi, on the tape."""
        taped, model, t, q = self.taped, self.taped.model, self.t, value_of(self.q)
        dq, dlam = self.system.solve(value_of(r), value_of(phi))

        def back(adjoint_q, adjoint_lam):
            """Solve with the same matrix for the adjoints of r and phi, and add the part of q."""
            alpha, nu = self.system.solve(adjoint_q, adjoint_lam)  # of minus the adjoint's right-hand side: minus its solution
            add_to(r, alpha)
            add_to(phi, nu)
            results = reaction_transposed(model, t, q, dlam, alpha) + reaction_transposed(model, t, q, nu, dq)
            add_to(self.q, results + model.mass_a_q(q, dq).T @ alpha if model.needs.mass_varies else results)
            taped.add_entry(t, q, a=dq, lam=dlam, w=alpha)
            taped.add_entry(t, q, w=-alpha)
            taped.add_entry(t, q, dq, kappa=nu)
            taped.add_entry(t, q, kappa=-nu)

        return tuple(taped.tape.record([dq, dlam], back))


def reaction_transposed(model, t, q, lam, x):
    """The derivative of the constraint forces transposed, `((B^T lam)_q)^T x`, (n,)."""
    if not (model.needs.phi_q_varies and model.m):
        return np.zeros(model.n)
    if model.compiled:
        from polyida.adjoint.products import reaction_product

        return reaction_product(model, t, lam, x)
    return model.reaction_q(t, q, lam).T @ x


@resolution.register
def _(model: TapedModel, settings, state, h):
    """F x on a tape. With y = F x, eta its multipliers and alpha, nu those of the adjoint, what moves y at fixed x is

    `d/ds alpha . r(q + s y, v + s c_v y, a + s c_m (y - x), lam + s eta) + nu . B (y - x)`: its slopes are differences of r's own.
    """
    c, (t, q, v, a, lam) = settings.coefficients, (state.t, *map(value_of, (state.q, state.v, state.a, state.lam)))
    c_m, c_v = 1 / (c.beta * h * h), c.gamma / (c.beta * h)
    system = ExactSaddle(model.model, c_m, c_v, Counts())
    system.at(t, q, v, a, lam)
    mass, border = model.model.mass(q), system.B

    def resolve(x):
        """F x of a vector x, on the tape."""
        y, eta = system.solve(c_m * (mass @ value_of(x)), border @ value_of(x))

        def back(adjoint):
            """Solve the transposed system for alpha and nu, and add the slopes of F x in x and in the state."""
            alpha, nu = system.solve(adjoint, np.zeros(model.m), transposed=True)
            add_to(x, c_m * (mass @ alpha) + border.T @ nu)
            _add_derivative_along(model, state, (y, c_v * y, c_m * (y - value_of(x)), eta), alpha, nu, y - value_of(x))

        return model.tape.record([y], back)[0]

    return resolve


def _add_derivative_along(taped, state, way, alpha, nu, gain):
    """Subtract the slopes of `d/ds alpha . r(state + s way) + nu . B gain` from the state's adjoints."""
    model, t, q = taped.model, state.t, value_of(state.q)
    now = [value_of(x) for x in (state.q, state.v, state.a, state.lam)]
    at = lambda s: [x + s * d for x, d in zip(now, way)]  # noqa: E731
    reach = (1.0 + np.abs(q).max()) / max(np.abs(way[0]).max(), 1e-300)
    add_to(state.q, -along(lambda s: residual_q(model, t, *at(s), alpha), reach) - reaction_transposed(model, t, q, nu, gain))
    if model.needs.velocity_forces:
        add_to(state.v, -along(lambda s: residual_v(model, t, *at(s)[:2], alpha), reach))
    if model.needs.mass_varies:
        add_to(state.a, -along(lambda s: model.mass(at(s)[0]) @ alpha, reach))
    if model.needs.phi_q_varies:
        add_to(state.lam, -along(lambda s: model.phi_q(t, at(s)[0]) @ alpha, reach))
    for s, weight in central(reach):
        taped.add_entry(t, *at(s), w=-weight * alpha)
    taped.add_entry(t, q, gain, kappa=-nu)
    taped.add_entry(t, q, kappa=nu)


@on_position.register
def _(model: TapedModel, t, q):
    """q on its constraints. Near them `M dq + B^T nu = 0`, `B dq = -phi`; rows of velocities move nothing."""
    if not model.m:
        return q
    on, whole = on_position(model.model, t, q.value), model.model

    def back(adjoint):
        """Add what comes back through the nearest point on the constraints."""
        _, nu = whole.mass_system(t, on).solve(adjoint, np.zeros(model.m))
        nu[model.velocity_rows] = 0.0
        add_to(q, adjoint + whole.phi_q(t, on).T @ nu)
        model.add_entry(t, on, mu=nu)

    return model.tape.record([on], back)[0]


@velocity_rate.register
def _(model: TapedModel, t, q, v):
    """The rate of the constraints, `phi_q v + phi_t`, on the tape, (m,); empty without constraints."""
    return model.phi_rate(t, q, v) if model.m else np.zeros(0)


@start_values.register
def _(model: TapedModel, state, t=None):
    """Of phi, which no other value is made of, nothing."""
    return np.zeros(model.m), velocity_rate(model, state.t if t is None else t, state.q, state.v)


def residual_q(model, t, q, v, a, lam, w):
    """The product `r_q^T w` with the derivative of the residual in q, (n,)."""
    if model.compiled:
        return _products(model, t, q, v, lam, w).stiff.ravel().copy()
    return model.tangent(t, q, v, a, lam, 0.0, 0.0, 1.0).T @ w


def residual_v(model, t, q, v, w):
    """The product `r_v^T w` with the derivative of the residual in v, (n,)."""
    if model.compiled:
        return _products(model, t, q, v, np.zeros(model.m), w).slowing.ravel().copy()
    return model.force_v(t, q, v).T @ w


def _products(model, t, q, v, lam, w):
    """The Scratch with the products of a compiled scene at a state."""
    from polyida.adjoint.products import products_at

    return products_at(model, model.drives(t), q, v, lam, w, np.zeros(model.m))
