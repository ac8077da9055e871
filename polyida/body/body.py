"""The base class of bodies: coordinates that are points of the complex plane, a constant mass, an elastic force, named points."""

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.joint.attachment import Attachment, OwnPart
from polyida.joint.formula import Row, Vector
from polyida.validation import complexes, floats, is_one_of, on_pairs, pairs_of, takes, vector2

SAME = 1e-9  # relative tolerance of equality


def require_whole(part, base, needed):
    """Raise InputError unless the class of a part is a dataclass with a name that defines the functions `needed` of its base."""
    kind = type(part)
    if not (is_dataclass(kind) and any(field.name == "name" for field in fields(kind))):
        raise InputError(f"{part.label}: its class needs @dataclass(frozen=True, eq=False) and the field `name: str | None = None`")
    for function in needed:
        if not writes(part, base, function):
            raise InputError(f"{part.label}: its class gives no {function}()")


def require_arguments(part, base, functions):
    """Raise InputError if a function that a part writes in place of that of its base class does not take the right number of arguments.

    functions: {name of a function: letters of its arguments}, without self; the letters are for the message.
    """
    for function, arguments in functions.items():
        if writes(part, base, function) and not takes(getattr(part, function), len(arguments)):
            raise InputError(f"{part.label}: {function}: its arguments must be ({', '.join(['self', *arguments])})")


def writes(part, base, function):
    """True if the class of a part overrides a function of its base."""
    return getattr(type(part), function) is not getattr(base, function)


def compiled_functions(part, base, *names):
    """Return {name: function that numba will compile} of those `names` that the class of a part overrides.

    base: the class whose own functions do not count. Empty without `@pi.compiled`, or if one of them calls functions that need Python.
    """
    from polyida.jit.owner_data import OwnData

    functions = {name: getattr(type(part), name) for name in names if writes(part, base, name)}
    return functions if part.by_numba and not OwnData(part, functions.values()).python else {}


class Body(OwnPart, part=False):
    """A body with complex coordinates z (pairs,), each a moving pair (x, y): `M z'' + elastic(z) = forces`, M constant.

    Base class of a user's frozen dataclass with a field `name`. Each point of the body is `x = sum w_k z_k` with constant complex weights
    w; joints, masses, loads and forces act on it through `body.at(name)`. q holds the displacements of the pairs from `coordinates()`,
    after the nodes of the plates. Gravity acts as `M T g`, T = `translation()`. Constant quantities are asked for once; z is read-only.

    `@polyida.compiled` above the class lets numba compile `elastic` and `energy`; else compiled steps call them in Python. A body with
    different masses in x and y, or with coordinates without mass, makes the integrators use their Python loops. Run summaries say both.

    Attributes
    ----------
    velocity : (2,) float, m/s
        Of the centre of mass at the start of a run; a class may make it a field.
    spin : float, rad/s
        About the centre of mass at the start of a run; a class may make it a field.
    """

    is_full = False  # True for a full plate, False for a body of few coordinates
    turns_only = False  # True if it keeps the direction of its sections at constant length; its points may do so by themselves
    plate: Any = None  # the plate whose mesh shows it; `nodal` then returns the displacements of the nodes
    truncation_error: Any = None  # of a reduced plate: a function that estimates what its modes cannot represent
    velocity: Any = (0.0, 0.0)
    spin: Any = 0.0

    def coordinates(self) -> "ArrayLike":
        """Return z in the reference configuration, (pairs,), complex: positions in m, or numbers without unit such as a direction."""
        raise NotImplementedError

    def mass_matrix(self) -> "ArrayLike":
        """Return M: Hermitian (pairs, pairs) with the kinetic energy `z'^H M z' / 2`, J, or real (2 pairs, 2 pairs) on (x_0, y_0, ...)."""
        raise NotImplementedError

    def attachments(self) -> "dict[str, ArrayLike]":
        """Return {name: weights (pairs,) of a point}, or (2, pairs) of a point and its direction, complex."""
        raise NotImplementedError

    def x_axis(self) -> "ArrayLike | None":
        """Return the weights (pairs,) of the body's x axis, the default direction of its points; None: there is none."""
        return None

    def translation(self) -> "ArrayLike":
        """Return T (pairs,), the change of each pair in a unit translation of the body; by default 1 for the first pair and 0 otherwise."""
        return np.arange(len(np.atleast_1d(self.coordinates()))) == 0

    def elastic(self, z: np.ndarray) -> "ArrayLike":
        """Return the slopes of the elastic energy W, `dW/dRe z + i dW/dIm z`, (pairs,), complex, at the complex coordinates z (pairs,).

        A class that does not define it is a rigid body.
        """
        raise NotImplementedError

    def elastic_z(self, z: np.ndarray) -> "ArrayLike | None":
        """Return the real derivative of `elastic` on (x_0, y_0, x_1, ...), (2 pairs, 2 pairs); None: by differences."""
        return None

    def energy(self, z: np.ndarray) -> float:
        """Return the elastic energy W, J, zero in the reference configuration."""
        raise NotImplementedError

    def compiled_functions(self) -> dict[str, Any]:
        """Return {"elastic", "energy": function(self, z)} for numba; empty if the class writes them in Python."""
        return compiled_functions(self, Body, "elastic", "energy")

    def rows(self) -> list[Row | Vector]:
        """Return its own constraints, as of a joint, made of `x` and `d` of its points; e.g. those that keep its coordinates rigid."""
        return []

    def form(self) -> "tuple[ArrayLike, ArrayLike] | None":
        """Return (form (K^2, K^2), shift (K^2,)) of the elastic energy `d^T form d / 2 + shift^T d`, J, or None.

        d is the change of y = (Re conj(z_i) z_j, i <= j; Im conj(z_i) z_j, i < j) since the reference configuration; z_1 ... z_K are the pairs without the first.
        Compiled kernels use the form instead of `elastic`.
        """
        return None

    def damping(self) -> tuple[float, float]:
        """Return (Rayleigh mass coefficient c, 1/s; Kelvin-Voigt time tau, s): forces `c M z'` and, of a form, `tau (dy/dz)^T form y'`."""
        return 0.0, 0.0

    def prony(self) -> "tuple[tuple[float, float], ...]":
        """Return the terms (g, tau), no unit and s, by which the stress of a form relaxes, as `prony` of `pi.Material`; none by default."""
        return ()

    def prepared(self, attachments: list[Attachment]) -> "Body":
        """Return the body for a scene whose parts use these attachments; a reduced plate computes its modes from them."""
        return self

    def fields_to_store(self, prepared: "Body", like: "Body | None" = None) -> dict[str, Any]:
        """Return the fields that a file stores because another computer may compute them differently.

        like: another prepared body; the fields are then chosen nearest to its fields among those with the same span.
        """
        return {}

    def weights_of(self, side: Attachment, part: str) -> np.ndarray:
        """Return the weights (pairs,), complex, of an attachment's "point" or "direction"."""
        return side.weights if part == "point" else side.turn_weights  # type: ignore[return-value]

    def pair_forces(self, side: Attachment, forces: np.ndarray) -> np.ndarray:
        """Return the forces on the pairs, (pairs,), that forces on the nodes of an attachment, complex, are equivalent to."""
        return forces

    def nodal(self, moved: np.ndarray) -> np.ndarray:
        """Return the displacements (nodes, 2), m, of the nodes of its plate for displacements of its pairs, complex."""
        raise NotImplementedError

    def require(self) -> None:
        """Raise InputError unless its class is complete and its functions return what they must."""
        require_whole(self, Body, ("coordinates", "mass_matrix", "attachments"))
        if writes(self, Body, "elastic") != writes(self, Body, "energy"):
            raise InputError(f"{self.label}: elastic(z) is the slope of energy(z); its class must give both, or none where it is rigid")
        constant = ("coordinates", "mass_matrix", "attachments", "translation", "x_axis", "damping", "form", "rows", "prony")
        require_arguments(self, Body, dict.fromkeys(constant, "") | dict.fromkeys(("elastic", "elastic_z", "energy"), "z"))
        named = self.attachments()
        if not isinstance(named, dict) or not named or not all(isinstance(name, str) and name for name in named):
            raise InputError(f"{self.label}: attachments() gave {str(named)[:80]}; it must give {{name: weights}}, one at least")
        mass_of(self), translation_of(self), form_of(self)

    def at(self, name: str, direction: "ArrayLike | None" = None) -> "BodyPoint":
        """Return a point by name, as a BodyPoint for joints, loads and masses.

        direction: of any length, in the body's axes in the reference configuration; by default its x axis. Raises InputError for an unknown name, and for a
        direction if the body has no x axis.
        """
        known = self.attachments()
        if not is_one_of(name, known):
            raise InputError(f"{self.label}: no attachment is called {name!r}; known: {', '.join(map(repr, known))}")
        return self.point_of(name, known[name], direction)

    def point_of(self, name: str, weights: "ArrayLike", direction: "ArrayLike | None" = None) -> "BodyPoint":
        """Return a point by its weights, in the format of `attachments()`; name: for messages."""
        z = coordinates_of(self)
        pairs, array = len(z), _finite(weights)
        if array is None or array.shape not in ((pairs,), (2, pairs)):
            want = f"its weights, ({pairs},), or those of its point and direction, (2, {pairs})"
            raise InputError(f"{self.label}: attachment {name!r} is given by {str(weights)[:80]}; it must be {want}, finite numbers")
        point, axis = array if array.ndim == 2 else (array, self.x_axis())
        if axis is None:
            if direction is not None:
                raise InputError(
                    f"{self.label}: attachment {name!r} has no direction to turn to {direction!r}; let the class give x_axis()"
                )
            return BodyPoint(self, np.arange(pairs, dtype=np.int32), point, None, 0.0, name)
        turn = 1.0 + 0j
        if direction is not None:
            turn = complex(*vector2(f"{self.label}: attachment {name!r}", "direction", direction))
        along = _finite(axis)
        if along is None or along.shape != z.shape:
            raise InputError(f"{self.label}: x_axis() gave {str(axis)[:80]}; it must be weights, ({pairs},), finite numbers")
        size = abs(along @ z) * abs(turn)
        if not size > 0:
            raise InputError(f"{self.label}: the direction of attachment {name!r} has no length at rest")
        return BodyPoint(self, np.arange(pairs, dtype=np.int32), point, along * turn / size, 0.0, name)

    def edges(self, *names: str) -> "BodyEdges":
        """Return the straight edges through named points in their order, with the body on their left, for `pi.Contact`.

        The first name again at the end closes them. Raises InputError for fewer than two points, points on each other, and edges that have
        named points of the body only on their right.
        """
        corners = [self.at(name) for name in names]
        closed, label = len(names) > 2 and names[0] == names[-1], f"{self.label}: edges({', '.join(map(repr, names))})"
        corners = corners[: len(corners) - closed]
        if len(names) < 2 or len({corner.name for corner in corners}) < len(corners):
            raise InputError(f"{label} needs two points or more, each once; the first one again at the end closes the edges")
        ends = [(k, (k + 1) % len(corners)) for k in range(len(names) - 1)]
        z, every = (np.array([complex(*point.point) for point in points]) for points in (corners, points_of(self)))
        depth = 0.0
        for i, j in ends:
            length = abs(z[j] - z[i])
            if not length > 0:
                raise InputError(f"{label}: {names[i]!r} and {names[j]!r} are at one place")
            left = ((every - z[i]) * (z[j] - z[i]).conjugate()).imag / length
            if left.max() <= SAME * length and left.min() < -SAME * length:
                raise InputError(f"{label}: the body lies on the right of {names[i]!r} to {names[j]!r}; give the points in reverse order")
            depth = min(depth or np.inf, left.max()) if left.max() > SAME * length else depth
        mean = self.point_of(", ".join(names), np.mean([corner.weights for corner in corners], axis=0))
        return BodyEdges(**{field.name: getattr(mean, field.name) for field in fields(mean)}, corners=tuple(names), depth=float(depth))


@dataclass(frozen=True, eq=False, repr=False)
class BodyPoint(Attachment):
    """A point of a Body: `x = sum w_i z_i`, `d = sum w'_i z_i`, weights (pairs,) complex, |d| = 1 in the reference configuration."""

    turns_only = True
    has_edges = False
    advice = "let its class give x_axis(), or the attachment a direction of its own"

    @property
    def point(self) -> np.ndarray:
        """Reference position of the point, (2,), m."""
        return pairs_of(self.weights @ coordinates_of(self.body))

    @property
    def direction(self) -> np.ndarray | None:
        """Reference direction, (2,), unit vector, or None."""
        return None if self.turn_weights is None else pairs_of(self.turn_weights @ coordinates_of(self.body))

    @property
    def size(self) -> float:
        """Typical size of its body, m: the largest magnitude of a coordinate in the reference configuration."""
        return float(np.abs(coordinates_of(self.body)).max())

    def on(self, body: Any) -> "Attachment":
        """Return the point of the same name of a similar body, whose weights may differ, with its direction turned by the same angle."""
        if self.name not in body.attachments():
            return replace(self, body=body)
        before, after = self.body.at(self.name), body.at(self.name)
        if self.turn_weights is None:
            return after
        k = np.argmax(np.abs(before.turn_weights))
        return replace(after, turn_weights=after.turn_weights * (self.turn_weights[k] / before.turn_weights[k]))

    def share(self, force: "ArrayLike") -> np.ndarray:
        """Return the forces on the pairs, (pairs, 2), that a force (2,) at the point is equivalent to."""
        return pairs_of(self.weights.conj() * (np.asarray(force, float) @ [1.0, 1j]))


@dataclass(frozen=True, eq=False, repr=False)
class BodyEdges(BodyPoint):
    """Straight edges through named points of a Body; its own point is their mean.

    Attributes
    ----------
    corners : tuple of str
        Names of the points, the first one again at the end if they are closed.
    depth : float, m
        Of the named points behind the edges; 0 if there are none.
    """

    corners: tuple = ()
    depth: float = 0.0
    has_edges = True

    def on(self, body: Any) -> "Attachment":
        """Return the edges through the points of the same names of a similar body."""
        return body.edges(*self.corners)

    def each(self) -> list[Attachment]:
        """Return the points at the ends of its edges."""
        return [self.body.at(name) for name in dict.fromkeys(self.corners)]

    def edge_ends(self) -> np.ndarray:
        """Return the numbers (k, 2) within `each()` of the ends of its edges."""
        number = {name: k for k, name in enumerate(dict.fromkeys(self.corners))}
        return np.array([[number[one], number[other]] for one, other in zip(self.corners, self.corners[1:])], np.int64)


def points_of(body):
    """Return all named points of a body as a list of BodyPoints."""
    return [body.at(name) for name in body.attachments()]


def sticks_between(points):
    """Segments (segments, 2 ends, 2) that draw a body without a mesh: a closed polygon through its points (k, 2).

    Two points give one segment. The points are taken in the order of their angles about their mean.
    """
    angles = np.arctan2(*(points - points.mean(axis=0)).T[::-1]) if len(points) else np.zeros(0)
    points = points[np.argsort(angles)]
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)[: 1 if len(points) == 2 else None]


def _finite(value):
    """A value as a complex array; None if it is none, or not finite."""
    array = complexes(value)
    return array if array is not None and np.isfinite(array).all() else None


def coordinates_of(body):
    """Return the coordinates of a body in the reference configuration, (pairs,) complex. Raise InputError naming it."""
    coordinates = body.coordinates()
    z = _finite(coordinates)
    if z is None or z.ndim != 1 or not z.size:
        raise InputError(
            f"{body.label}: coordinates() gave {str(coordinates)[:80]}; it must give a list of finite complex numbers, at least one"
        )
    return z


def mass_of(body):
    """Return (M, None), M (pairs, pairs) Hermitian, or for different masses in x and y (None, M), M real on (x_0, y_0, x_1, ...).

    Raise InputError if M is not Hermitian positive semidefinite.
    """
    pairs, matrix = len(coordinates_of(body)), _finite(body.mass_matrix())
    if matrix is None or matrix.shape not in ((pairs, pairs), (2 * pairs, 2 * pairs)):
        raise InputError(
            f"{body.label}: mass_matrix() gave {'nothing of the kind' if matrix is None else matrix.shape}; it must give finite numbers "
            f"({pairs}, {pairs}), or on both of each pair ({2 * pairs}, {2 * pairs})"
        )
    size = np.abs(matrix).max()
    if np.abs(matrix - matrix.conj().T).max() > SAME * size:
        raise InputError(f"{body.label}: mass_matrix() is not Hermitian (symmetric where it is real)")
    whole = on_pairs(matrix) if len(matrix) == pairs else matrix
    if np.any(whole.imag) or np.linalg.eigvalsh(whole.real)[0] < -SAME * size:
        raise InputError(f"{body.label}: mass_matrix() must be positive semidefinite, and real where it is on both of each pair")
    if len(matrix) == pairs:
        return matrix, None
    xx, xy, yx, yy = (matrix.real[i::2, k::2] for i in range(2) for k in range(2))
    uniform = max(np.abs(xx - yy).max(), np.abs(xy + yx).max()) <= SAME * size
    return (xx + 1j * yx, None) if uniform else (None, matrix.real)


def form_of(body):
    """Return (form, shift) of a body as arrays, or None. Raise InputError for wrong shapes or numbers."""
    parts = body.form()
    if parts is None:
        return None
    form, shift = (floats(part) for part in parts)
    size = (len(coordinates_of(body)) - 1) ** 2
    if form is None or shift is None or form.shape != (size, size) or shift.shape != (size,):
        raise InputError(f"{body.label}: form() must give finite numbers ({size}, {size}) and ({size},)")
    return form, shift


def translation_of(body):
    """Return T, (pairs,), complex. Raise InputError unless T moves each point of the body by 1 and turns no direction."""
    z = coordinates_of(body)
    T = _finite(body.translation())
    if T is None or T.shape != z.shape:
        raise InputError(f"{body.label}: translation() must give finite numbers ({len(z)},), how much each pair moves with the whole body")
    for point in points_of(body):
        if abs(point.weights @ T - 1.0) > SAME or (point.has_direction and abs(point.turn_weights @ T) > SAME):
            raise InputError(
                f"{body.label}: by translation() {T.tolist()} attachment {point.name!r} moves by "
                f"{complex(np.round(point.weights @ T, 9)):g} and must move by 1, and its direction by nothing; give the translation() of "
                "these coordinates"
            )
    return T
