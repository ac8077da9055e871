"""Force elements, and elastic forces of users' bodies, evaluated in Python on places that are linear in q."""

from contextlib import nullcontext
from copy import copy
from dataclasses import fields, replace

import numpy as np

from polyida.body.body import writes
from polyida.errors import InputError
from polyida.force.force_element import ForceElement, sides_of
from polyida.model import differences
from polyida.profile import constant, difference
from polyida.validation import complexes, floats, is_number, on_pairs, pairs_of, read_only, reals

SORT = {reals: "real", complexes: "complex"}
NEAR = 1e-3  # relative range of finite differences: contact forces change over such distances


class OwnForce:
    """A force element in its scene. Its sides are at `x = rest + A q`, A (2 sides, n) sparse; `near` holds the columns of A that are not zero.

    sizes (sides, 1): typical size of each side's coordinates: the scene's, m, or 1 for a direction. strain: True if its energy is strain
    energy of a body. not_finite: the function that last raised, or returned a non-finite value for finite arguments; else empty.
    """

    strain = False

    def __init__(self, name, element, model):
        from scipy.sparse import csr_array

        self.name, self.element, self.not_finite = name, element, ""
        sides = sides_of(name, element)
        self.rest = np.array([side.rest for side in sides])
        held = [(k, *model.held(side.at, side.part)) for k, side in enumerate(sides) if side.at is not None]
        rows = np.concatenate([np.full(len(pairs), k) for k, pairs, _ in held])
        columns, weights = (np.concatenate([entry[i] for entry in held]) for i in (1, 2))
        self.A = on_pairs(csr_array((weights, (rows, columns)), shape=(len(sides), model.n_nodes)))
        self.columns = np.unique(self.A.tocsr().indices)
        self.near = self.A[:, self.columns].toarray()
        self.sizes = np.array([[side.size(model.extent)] for side in sides])

    def pushed(self, profile, by):
        """This force with the profile, if it is one of its fields, increased by `by`."""
        names = [field.name for field in fields(self.element) if getattr(self.element, field.name) is profile]
        if not names:
            return self
        other = copy(self)
        other.element = replace(self.element, **dict.fromkeys(names, difference(profile, constant(-by))))
        return other

    def places(self, q):
        """Places of the sides, (sides, 2), m."""
        return self.rest + self.velocities(q)

    def velocities(self, v):
        """Velocities of the sides, (sides, 2), m/s."""
        return (self.near @ v[self.columns]).reshape(-1, 2)

    def forces(self, t, x, v):
        """Forces on the sides, (sides, 2), N."""
        return self._call("forces", x.shape, t, x, v)

    def energy(self, x):
        """Energy, J; 0 without. Raises InputError if it is no finite number."""
        value = self.element.energy(read_only(x))
        if value is None:
            return 0.0
        if not is_number(value):
            raise InputError(f"{self.name}: energy(x) must return a finite number or None, not {value!r}")
        return float(value)

    def conservative(self, t, x):
        """Forces at zero velocity, (sides, 2), if they must be the negative gradient of the energy; else None."""
        if self.element.works or not writes(self.element, ForceElement, "energy"):
            return None
        now, later = (self.forces(at, x, np.zeros_like(x)) for at in (t, t + differences.LATER))
        return now if np.array_equal(now, later) else None

    @property
    def python(self):
        """True if its forces or its energy are Python functions."""
        functions = self.element.compiled_functions()
        return not functions or ("energy" not in functions and writes(self.element, ForceElement, "energy"))

    @property
    def switches(self):
        """True if it declares switches."""
        return writes(self.element, ForceElement, "gap")

    def gaps(self, q):
        """Gaps at q, (k,). Raises InputError if they are no finite numbers."""
        given = self.element.gap(read_only(self.places(q)))
        gaps = None if given is None else floats(given)
        if gaps is None or gaps.ndim > 1:
            raise InputError(f"{self.name}: gap(x) must return a finite number or an array (k,) of them, not {given!r:.100}")
        return gaps.reshape(-1)

    def slopes(self, t, x, v, c_v, c_q):
        """`c_v df/dv + c_q df/dx`, (2 sides, 2 sides)."""
        result = np.zeros((x.size, x.size))
        for c, name, moved in (
            (c_v, "forces_v", lambda d: self.forces(t, x, v + d)),
            (c_q, "forces_x", lambda d: self.forces(t, x + d, v)),
        ):
            if c and getattr(self.element, name)(t, read_only(x), read_only(v)) is not None:
                result += c * self._call(name, x.shape * 2, t, x, v).reshape(x.size, x.size)
            elif c:
                result += c * self._differences(x, moved)
        return result

    def _differences(self, x, moved):
        """Derivative of `moved(d)` in d, of the shape of x, (2 sides, 2 sides)."""
        reach = NEAR * self.sizes
        change, size = (lambda s: moved(reach * s.reshape(x.shape)).ravel()), x.size
        return differences.jacobian(change, np.zeros(size), size) / np.broadcast_to(reach, x.shape).ravel()

    def _call(self, name, shape, *arguments, numbers=reals):
        """Call a function of the element, and check its result."""
        try:
            with np.errstate(all="ignore") if self.element.by_numba else nullcontext():
                result = getattr(self.element, name)(*(read_only(x) if isinstance(x, np.ndarray) else x for x in arguments))
            values = numbers(result)
            if values is None or values.shape != shape:
                try:
                    form = np.shape(result)
                except ValueError:
                    form = "uneven"
                what = f"{type(result).__name__} of shape {form}"
                raise InputError(f"{self.name}: {name} must return {SORT[numbers]} numbers of shape {shape}, not {what}")
        except Exception as error:
            self.not_finite = f"{name} of {self.name!r} raised {type(error).__name__}: {error}"
            if isinstance(error, ValueError) and "read-only" in str(error):
                wrong = "writes into its arguments, which belong to the integrator: take a copy first"
                raise InputError(f"{self.name}: {name} {wrong}") from error
            raise
        bad = not np.isfinite(values).all() and all(np.isfinite(x).all() for x in arguments)
        why = self.element.undefined(arguments[1]) if bad and len(arguments) == 3 else ""
        self.not_finite = f"{name} of {self.name!r} gave numbers that are not finite{': ' * bool(why)}{why}" if bad else ""
        return values


class Elastic(OwnForce):
    """The elastic force of a user's body, as a force on its pairs."""

    strain = True
    switches = False

    def __init__(self, placed, n_pairs):
        from scipy.sparse import eye_array

        self.name, self.element, self.not_finite = placed.name, placed.body, ""
        self.rest = pairs_of(placed.rest)
        self.columns = slice(2 * placed.pairs.start, 2 * placed.pairs.stop)
        self.A = eye_array(2 * n_pairs, format="csr")[self.columns]
        self.sizes = np.full((len(self.rest), 1), float(abs(self.rest).max()) or 1.0)

    def velocities(self, v):
        return v[self.columns].reshape(-1, 2)

    def forces(self, t, x, v):
        return -pairs_of(self._call("elastic", (len(x),), x @ (1, 1j), numbers=complexes))

    def conservative(self, t, x):
        """Its forces: they must be the negative gradient of energy(z)."""
        return self.forces(t, x, x)

    def energy(self, x):
        return super().energy(x @ (1, 1j))

    def slopes(self, t, x, v, c_v, c_q):
        if not c_q:
            return np.zeros((x.size, x.size))
        if self.element.elastic_z(x @ (1, 1j)) is not None:
            return -c_q * self._call("elastic_z", (x.size, x.size), x @ (1, 1j))
        return c_q * self._differences(x, lambda d: self.forces(t, x + d, v))


class OwnForces:
    """All these forces, as a part of g: `g = ... - A^T f`."""

    def __init__(self, each, n):
        self.each, self.n = each, n

    def __bool__(self):
        return bool(self.each)

    def pushed(self, profile, by):
        """These forces with a profile increased by `by`."""
        return OwnForces([own.pushed(profile, by) for own in self.each], self.n)

    def take_from(self, r, t, q, v):
        """Subtract the forces from r (n,), in place."""
        for own in self.each:
            r -= own.A.T @ own.forces(t, own.places(q), own.velocities(v)).ravel()

    def slopes(self, t, q, v, c_v, c_q):
        """`c_v dg/dv + c_q dg/dq`, (n, n) sparse."""
        from scipy.sparse import csc_array

        result = csc_array((self.n, self.n))
        for own in self.each:
            result = result - own.A.T @ csc_array(own.slopes(t, own.places(q), own.velocities(v), c_v, c_q)) @ own.A
        return result

    def energy(self, q, strain):
        """Their energy, J: strain energy of bodies, or all other energy."""
        return sum((own.energy(own.places(q)) for own in self.each if own.strain == strain), 0.0)

    def gaps(self, q):
        """Gaps of the force elements with switches, (k,)."""
        return np.concatenate([own.gaps(q) for own in self.each if own.switches])

    def gap_names(self, q):
        """Name of the force element of each of `gaps`."""
        return [repr(own.name) for own in self.each if own.switches for _ in own.gaps(q)]

    @property
    def not_finite(self):
        """The functions that last gave non-finite values; empty if there are none."""
        return " and ".join(own.not_finite for own in self.each if own.not_finite)
