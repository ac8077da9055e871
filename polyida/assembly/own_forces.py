"""Force elements, and elastic forces of users' bodies, evaluated in Python on places that are linear in q."""

from copy import copy
from dataclasses import fields, replace

import numpy as np

from polyida.assembly.python_functions import PythonFunctions
from polyida.body.body import writes
from polyida.errors import InputError, StepFailure
from polyida.force.controllers import Controller
from polyida.force.force_element import ForceElement, sides_of
from polyida.linear.lu import summed
from polyida.model import differences
from polyida.model.differences import along
from polyida.model.states import solved
from polyida.profile import constant, difference
from polyida.validation import complexes, floats, on_pairs, pairs_of, read_only, reals

NEAR = 1e-3  # relative range of finite differences: contact forces change over such distances


class OwnForce:
    """A force element in its scene. Its sides are at `x = rest + A q`, A (2 sides, n) sparse; `near` holds the columns of A that are not zero.

    sizes (sides, 1): typical size of each side's coordinates: the scene's, m, or 1 for a direction. strain: True if its energy is strain
    energy of a body. functions: its PythonFunctions; given where compiled code calls them too.
    """

    strain = False
    names: tuple[str, ...] = ()  # of its states, the algebraic ones, and the outputs of a controller
    period = 0.0  # s, of a controller

    def __init__(self, name, element, model, functions=None):
        """Take a force element and find where its sides are in a scene's model: rest, A, columns, near, sizes and the places of its states.

        name: of the element in the scene. functions: its PythonFunctions, made here by default.
        """
        from scipy.sparse import csr_array

        self.name, self.element, self.functions = name, element, functions or PythonFunctions(name, element)
        sides, self.placed = sides_of(name, element), model.states.get(name)
        self.own_sides, self.names = slice(len(sides)), element.states + element.algebraic
        if isinstance(element, Controller):
            self.period, self.names = element.period, self.names + element.outputs
        sides += self.placed.sides() if self.placed else ()
        self.rest = np.array([side.rest for side in sides])
        attachments = [(k, *model.pairs_and_weights(side.at, side.part)) for k, side in enumerate(sides) if side.at is not None]
        rows = np.concatenate([np.full(len(pairs), k) for k, pairs, _ in attachments])
        columns, weights = (np.concatenate([entry[i] for entry in attachments]) for i in (1, 2))
        self.A = on_pairs(csr_array((weights, (rows, columns)), shape=(len(sides), model.n_nodes)))
        self.columns = np.unique(self.A.tocsr().indices)
        self.near = self.A[:, self.columns].toarray()
        self.sizes, self.last_slopes = np.array([[side.size(model.extent)] for side in sides]), {}

    def pushed(self, profile, by):
        """This force with the profile, if it is one of its fields, increased by `by`."""
        names = [field.name for field in fields(self.element) if getattr(self.element, field.name) is profile]
        return self.with_element(replace(self.element, **dict.fromkeys(names, difference(profile, constant(-by))))) if names else self

    def with_element(self, element):
        """This force with another element of the same sides and states."""
        other = copy(self)
        other.element, other.functions, other.last_slopes = element, PythonFunctions(self.name, element), {}
        return other

    def places(self, q):
        """Places of the sides, (sides, 2), m."""
        return self.rest + self.velocities(q)

    def velocities(self, v):
        """Velocities of the sides, (sides, 2), m/s."""
        return (self.near @ v[self.columns]).reshape(-1, 2)

    def forces(self, t, x, v):
        """Forces on the sides, (sides, 2), N; on states as of PlacedStates."""
        if not self.names:
            return self._call("forces", x.shape, t, x, v)
        own, speeds, states = x[self.own_sides], v[self.own_sides], self.all_states(t, x, v)
        if not np.isfinite(states[0]).all() and self.not_finite:
            return np.full(x.shape, np.nan)
        forces, first = self._call("forces", own.shape, t, own, speeds, *states), len(self.element.states)
        if not self.placed:
            return forces
        rates = self._call("rates", states[0].shape, t, own, speeds, *states)[:first] if first else np.zeros(0)
        return np.concatenate([forces, self.placed.forces_of(rates)])

    def states(self, v):
        """The states (states,), and of a controller its outputs (outputs,), from velocities of the sides, (sides, 2)."""
        return self.placed.states_of(v[self.own_sides.stop :]) if self.placed else (np.zeros(0),)

    def all_states(self, t, x, v):
        """`states` with the algebraic ones, at places x; nan for these if they have no solution."""
        (s, *outputs), element = self.states(v), self.element
        if not element.algebraic:
            return s, *outputs
        first, x, v = len(s), x[self.own_sides], v[self.own_sides]

        def rates(free):
            """What is zero for the algebraic states `free`, at the given other states, places and velocities."""
            whole = np.append(s, free)
            return self._call("rates", whole.shape, t, x, v, whole, *outputs)[first:]

        start, sizes = (np.array(values, float)[first:] for values in (element.start(), element.sizes()))
        free, why = solved(rates, start, sizes)
        if why:
            self.functions.not_finite = f"the algebraic states {', '.join(element.algebraic)} of {self.name!r} have no solution: {why}"
        return np.append(s, free), *outputs

    def states_at(self, t, q, v):
        """The values of `names` at a state of the scene."""
        return np.concatenate(self.all_states(t, self.places(q), self.velocities(v)))

    def sample(self, t, q, v, after):
        """Put the outputs of a controller that samples at (t, q, v) into the velocities `after`."""
        x, speeds = self.places(q), self.velocities(v)
        states = self.all_states(t, x, speeds)
        outputs = self._call("sample", states[-1].shape, t, x[self.own_sides], speeds[self.own_sides], *states)
        if self.not_finite:
            raise StepFailure("not finite", self.not_finite, t)
        after[self.placed.columns[self.placed.own :]] = outputs / self.placed.units[self.placed.own :]

    def energy(self, x, v=None):
        """Energy, J; 0 without. v: velocities of the sides, needed if there are states. Raises InputError if it is no number."""
        if not self.strain and not writes(self.element, ForceElement, "energy"):
            return 0.0
        return self.functions.energy(x[self.own_sides], *self.states(v)) if self.placed else self.functions.energy(x)

    def power(self, t, q, v):
        """Work done on the system beyond the energy, W: `f . v + dE/dt`."""
        x, speeds = self.places(q), self.velocities(v)
        forces, rates = self.forces(t, x, speeds), np.zeros_like(speeds)
        if self.placed:
            rates[self.own_sides.stop :] = forces[self.own_sides.stop :] / self.placed.mass[0, 0].real
            forces = forces[self.own_sides]
        pace = float(max(np.abs(speeds[self.own_sides] / self.sizes[self.own_sides]).max(), np.abs(rates / self.sizes).max()))
        if not pace:
            return 0.0
        power, moved = float(np.vdot(forces, speeds[self.own_sides])), speeds / pace
        return power + pace * float(along(lambda s: self.energy(x + s * moved, speeds + s / pace * rates), NEAR))

    def conservative(self, t, x):
        """Forces at zero velocity, (sides, 2), if they must be the negative gradient of the energy; else None."""
        if self.names or self.element.works or not writes(self.element, ForceElement, "energy"):
            return None
        now, later = (self.forces(at, x, np.zeros_like(x)) for at in (t, t + differences.LATER))
        return now if np.array_equal(now, later) else None

    @property
    def switches(self):
        """True if it declares switches."""
        return writes(self.element, ForceElement, "gap")

    def gaps(self, q):
        """Gaps at q, (k,). Raises InputError if they are no finite numbers."""
        places = self.places(q)
        values = self.element.gap(read_only(places[self.own_sides] if self.placed else places))
        gaps = None if values is None else floats(values)
        if gaps is None or gaps.ndim > 1:
            raise InputError(f"{self.name}: gap(x) must return a finite number or an array (k,) of them, not {values!r:.100}")
        return gaps.reshape(-1)

    def slopes(self, t, x, v, c_v, c_q):
        """`c_v df/dv + c_q df/dx`, (2 sides, 2 sides)."""
        result, at = np.zeros((x.size, x.size)), (t, x, v)
        for c, name in ((c_v, "forces_v"), (c_q, "forces_x")):
            if c:
                of_last, slope = self.last_slopes.get(name, (None, None))
                if of_last is None or not all(map(np.array_equal, of_last, at)):  # a step matrix and its C ask for the same ones
                    slope = self._slope(name, t, x, v)
                    self.last_slopes[name] = at, slope
                result += c * slope
        return result

    def _slope(self, name, t, x, v):
        """The derivative forces_v or forces_x, (2 sides, 2 sides): the user's own, or by differences. Places of states have no influence."""
        if not self.names and getattr(self.element, name)(t, read_only(x), read_only(v)) is not None:
            return self._call(name, x.shape * 2, t, x, v).reshape(x.size, x.size)
        if name == "forces_v":
            return self._differences(x, lambda d: self.forces(t, x, v + d), x.size)
        return self._differences(x, lambda d: self.forces(t, x + d, v), x[self.own_sides].size)

    def _differences(self, x, moved, columns):
        """Derivative of `moved(d)` in the first entries of d, of the shape of x; the other columns are zero, (2 sides, 2 sides)."""
        reach, result = NEAR * np.broadcast_to(self.sizes, x.shape).ravel(), np.zeros((x.size, x.size))

        def change(s):
            """`moved(d)` as a vector; the first entries of d are s times small changes of the coordinates."""
            d = np.zeros(x.size)
            d[:columns] = reach[:columns] * s
            return moved(d.reshape(x.shape)).ravel()

        result[:, :columns] = differences.jacobian(change, np.zeros(columns), x.size) / reach[:columns]
        return result

    def _call(self, name, shape, *arguments, numbers=reals):
        """Call a function of the element, and check its result."""
        return self.functions.call(name, shape, *(read_only(x) if isinstance(x, np.ndarray) else x for x in arguments), numbers=numbers)

    @property
    def not_finite(self):
        """The function that last gave numbers that are not finite, in words; empty if none did."""
        return self.functions.not_finite


class Elastic(OwnForce):
    """The elastic force of a user's body, as a force on its pairs."""

    strain, placed, near = True, None, None
    switches = False

    def __init__(self, placed, n_pairs, functions):
        """placed: a body with elastic forces in Python. n_pairs: of the scene."""
        from scipy.sparse import eye_array

        self.name, self.element, self.functions = placed.name, placed.body, functions
        self.rest = pairs_of(placed.rest)
        self.columns = slice(2 * placed.pairs.start, 2 * placed.pairs.stop)
        self.A = eye_array(2 * n_pairs, format="csr")[self.columns]
        self.sizes = np.full((len(self.rest), 1), float(abs(self.rest).max()) or 1.0)

    def velocities(self, v):
        """Return the velocities of the body's pairs, (pairs, 2), from v (n,)."""
        return v[self.columns].reshape(-1, 2)

    def forces(self, t, x, v):
        """Return the forces on the body's pairs, (pairs, 2): minus `elastic` of its complex coordinates x (pairs, 2)."""
        return -pairs_of(self._call("elastic", (len(x),), x @ (1, 1j), numbers=complexes))

    def conservative(self, t, x):
        """The body's elastic forces at the coordinates x (pairs, 2), which must be the negative gradient of its energy; they depend on x alone."""
        return self.forces(t, x, x)

    def energy(self, x, v=None):
        """Return the elastic energy, J, at the coordinates x (pairs, 2); it does not depend on v."""
        return super().energy(x @ (1, 1j))

    def slopes(self, t, x, v, c_v, c_q):
        """Return the slopes `c_q d(force)/dx` of the elastic force of the body; it does not depend on v."""
        if not c_q:
            return np.zeros((x.size, x.size))
        if self.element.elastic_z(x @ (1, 1j)) is not None:
            return -c_q * self._call("elastic_z", (x.size, x.size), x @ (1, 1j))
        return c_q * self._differences(x, lambda d: self.forces(t, x + d, v), x.size)


def take_from(r, forces, t, q, v):
    """Subtract forces, a part of g, `g = ... - A^T f`, from r (n,), in place."""
    for own in forces:
        r -= own.A.T @ own.forces(t, own.places(q), own.velocities(v)).ravel()


def slope_entries(forces, t, q, v, c_v, c_q):
    """[(rows, columns, values)] of each force's `c_v dg/dv + c_q dg/dq`."""
    entries = []
    for own in forces:
        block, at = -own.slopes(t, own.places(q), own.velocities(v), c_v, c_q), np.arange(q.size)[own.columns]
        if own.near is not None:
            block = own.near.T @ block @ own.near
        rows, columns = np.nonzero(block)
        entries.append((at[rows], at[columns], block[rows, columns]))
    return entries


def slopes_of(forces, t, q, v, c_v, c_q):
    """`c_v dg/dv + c_q dg/dq` of forces, (n, n) sparse."""
    return summed(slope_entries(forces, t, q, v, c_v, c_q), q.size)
