"""The force elements of a scene in Python, on places that are linear in q."""

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
NEAR = 1e-3  # of the size of what is varied: forces of contact change within that


class OwnForce:
    """A force element in its scene: its sides are at `x = rest + A q`, A (2 sides, n) sparse, `near` its columns that are not zero; the ground's rows are.

    sizes: of what each side says, (sides, 1): the scene's, m, or one of a direction; derivatives are taken over NEAR of them. strain:
    whether its energy is that of a body's strain.
    not_finite: in words, which of its functions last raised, or gave what is not finite for arguments that are; else empty.
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
        """This one with a profile, where it is one of its fields, greater by `by`."""
        held = [field.name for field in fields(self.element) if getattr(self.element, field.name) is profile]
        if not held:
            return self
        other = copy(self)
        other.element = replace(self.element, **dict.fromkeys(held, difference(profile, constant(-by))))
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
        """Its energy, J; zero where it has none. Raises InputError for what is no finite number."""
        return self._energy(x)

    def conservative(self, t, x):
        """Its forces where nothing moves, (sides, 2), if its energy must have them as falling slope; None where it need not."""
        if self.element.works or not writes(self.element, ForceElement, "energy"):
            return None
        here, later = (self.forces(at, x, np.zeros_like(x)) for at in (t, t + differences.LATER))
        return here if np.array_equal(here, later) else None

    def _energy(self, x):
        value = self.element.energy(read_only(x))
        if value is None:
            return 0.0
        if not is_number(value):
            raise InputError(f"{self.name}: energy(x) must return a finite number or None, not {value!r}")
        return float(value)

    @property
    def python(self):
        """Whether its forces or its energy are Python."""
        functions = self.element.compiled_functions()
        return not functions or ("energy" not in functions and writes(self.element, ForceElement, "energy"))

    @property
    def switches(self):
        """Whether it declares switches."""
        return writes(self.element, ForceElement, "gap")

    def gaps(self, q):
        """Its gaps at q, (k,). Raises InputError for what are no finite numbers."""
        given = self.element.gap(read_only(self.places(q)))
        found = None if given is None else floats(given)
        if found is None or found.ndim > 1:
            raise InputError(f"{self.name}: gap(x) must return a finite number or an array (k,) of them, not {given!r:.100}")
        return found.reshape(-1)

    def slopes(self, t, x, v, c_v, c_q):
        """`c_v df/dv + c_q df/dx`, (2 sides, 2 sides)."""
        result = np.zeros((x.size, x.size))
        if c_v:
            result += c_v * self._slope("forces_v", t, x, v, lambda d: self.forces(t, x, v + d))
        if c_q:
            result += c_q * self._slope("forces_x", t, x, v, lambda d: self.forces(t, x + d, v))
        return result

    def _slope(self, name, t, x, v, moved):
        if getattr(self.element, name)(t, read_only(x), read_only(v)) is not None:
            return self._call(name, x.shape * 2, t, x, v).reshape(x.size, x.size)
        return self._differences(x, moved)

    def _differences(self, x, moved):
        """Derivative of `moved(d)`, d the size of x, (2 sides, 2 sides)."""
        reach = NEAR * self.sizes
        change, size = (lambda s: moved(reach * s.reshape(x.shape)).ravel()), x.size
        return differences.jacobian(change, np.zeros(size), size) / np.broadcast_to(reach, x.shape).ravel()

    def _call(self, name, shape, *given, numbers=reals):
        try:
            with np.errstate(all="ignore") if self.element.by_numba else nullcontext():
                result = getattr(self.element, name)(*(read_only(x) if isinstance(x, np.ndarray) else x for x in given))
            found = numbers(result)
            if found is None or found.shape != shape:
                what = f"{type(result).__name__} of shape {_shape(result)}"
                raise InputError(f"{self.name}: {name} must return {SORT[numbers]} numbers of shape {shape}, not {what}")
        except Exception as error:
            self.not_finite = f"{name} of {self.name!r} raised {type(error).__name__}: {error}"
            if isinstance(error, ValueError) and "read-only" in str(error):
                wrong = "writes into its arguments, which belong to the integrator: take a copy first"
                raise InputError(f"{self.name}: {name} {wrong}") from error
            raise
        bad = not np.isfinite(found).all() and all(np.isfinite(x).all() for x in given)
        why = self.element.undefined(given[1]) if bad and len(given) == 3 else ""
        self.not_finite = f"{name} of {self.name!r} gave numbers that are not finite{': ' * bool(why)}{why}" if bad else ""
        return found


class OwnForces:
    """All of them, as a part of g: `g = ... - A^T f`."""

    def __init__(self, each, n):
        self.each, self.n = each, n

    def __bool__(self):
        return bool(self.each)

    def pushed(self, profile, by):
        """These with a profile, wherever it is one of their fields, greater by `by`."""
        return OwnForces([own.pushed(profile, by) for own in self.each], self.n)

    def take_from(self, r, t, q, v):
        """Take the forces from r (n,), in place."""
        for own in self.each:
            r -= own.A.T @ own.forces(t, own.places(q), own.velocities(v)).ravel()

    def slopes(self, t, q, v, c_v, c_q):
        """`c_v dg/dv + c_q dg/dq` of them, (n, n) sparse."""
        from scipy.sparse import csc_array

        result = csc_array((self.n, self.n))
        for own in self.each:
            result = result - own.A.T @ csc_array(own.slopes(t, own.places(q), own.velocities(v), c_v, c_q)) @ own.A
        return result

    def energy(self, q, strain):
        """Energy of those that have one, J: of bodies' strain, or all other."""
        return sum((own.energy(own.places(q)) for own in self.each if own.strain == strain), 0.0)

    def gaps(self, q):
        """Gaps of those that declare switches, (k,)."""
        return np.concatenate([own.gaps(q) for own in self.each if own.switches])

    def gap_names(self, q):
        """What each of `gaps` belongs to."""
        return [repr(own.name) for own in self.each if own.switches for _ in own.gaps(q)]

    @property
    def not_finite(self):
        """Which functions last gave what is not finite, in words; else empty."""
        return " and ".join(own.not_finite for own in self.each if own.not_finite)


def _shape(given):
    try:
        return np.shape(given)
    except ValueError:
        return "uneven"


def uneven_mass(placed, n):
    """Mass (n, n) sparse of the bodies whose x and y carry different ones; None where there are none."""
    return _placed([(2 * body.pairs.start, body.uneven) for body in placed if body.uneven is not None], n)


def uneven_drag(placed, n):
    """`drag M` (n, n) sparse of the same bodies, which kernels leave out with their M; None where none of them has a drag."""
    drags = [(body, body.body.damping()[0]) for body in placed if body.uneven is not None]
    return _placed([(2 * body.pairs.start, drag * body.uneven) for body, drag in drags if drag], n)


def _placed(blocks, n):
    """(n, n) sparse of blocks, (first row, matrix) each; None where there are none."""
    from scipy.sparse import coo_array

    if not blocks:
        return None
    entries = [(first + i, first + k, block[i, k]) for first, block in blocks for i in range(len(block)) for k in range(len(block))]
    rows, columns, values = zip(*entries)
    return coo_array((values, (rows, columns)), shape=(n, n)).tocsc()


class Elastic(OwnForce):
    """The elastic force of a body of one's own, as a force on its pairs."""

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
        """Velocities of the pairs, (pairs, 2), m/s."""
        return v[self.columns].reshape(-1, 2)

    def forces(self, t, x, v):
        """Forces on the pairs, (pairs, 2)."""
        return -pairs_of(self._call("elastic", (len(x),), x @ (1, 1j), numbers=complexes))

    def conservative(self, t, x):
        """Its forces: energy(z) is always theirs."""
        return self.forces(t, x, x)

    def energy(self, x):
        """Elastic energy, J."""
        return self._energy(x @ (1, 1j))

    def slopes(self, t, x, v, c_v, c_q):
        """`c_q df/dx`, (2 pairs, 2 pairs)."""
        if not c_q:
            return np.zeros((x.size, x.size))
        if self.element.elastic_z(x @ (1, 1j)) is not None:
            return -c_q * self._call("elastic_z", (x.size, x.size), x @ (1, 1j))
        return c_q * self._differences(x, lambda d: self.forces(t, x + d, v))
