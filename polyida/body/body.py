"""What the parts of a user's own have in common, and what every body of one's own is: coordinates that are points of the complex plane, a
constant mass, an elastic force, named points.
"""

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida import registry
from polyida.errors import InputError
from polyida.joint.attachment import Attachment, labelled
from polyida.joint.formula import Row, Vector
from polyida.validation import complexes, floats, is_one_of, on_pairs, pairs_of, vector2


class OwnPart:
    """A part whose class is a user's: a frozen dataclass with a field `name`; its other fields are its data and are saved with it."""

    name: str | None = None
    by_numba = False  # True of a class whose functions numba compiles (jit/compiled.py)

    def __init_subclass__(cls, part: bool = True, **options):
        """part: whether the class is of parts that files find by its name, not of what parts are made of."""
        super().__init_subclass__(**options)
        if part:
            registry.parts[registry.name_of(cls)] = cls

    @property
    def label(self) -> str:
        """What messages call it."""
        return labelled(type(self).__name__, self.name)


def require_whole(part, base, needed):
    """Raise InputError unless the class of a part is a dataclass with a name and writes the functions `needed` of its base."""
    kind = type(part)
    if not (is_dataclass(kind) and any(field.name == "name" for field in fields(kind))):
        needs = "a dataclass with a field `name: str | None = None`; decorate it with @dataclass(frozen=True, eq=False)"
        raise InputError(f"{part.label}: its class must be {needs}")
    for function in needed:
        if not writes(part, base, function):
            raise InputError(f"{part.label}: its class gives no {function}()")


def writes(part, base, function):
    """Whether the class of a part writes a function of its base anew."""
    return getattr(type(part), function) is not getattr(base, function)


def compiled_functions(part, base, *names):
    """{name: function} of those that the class of a part writes, for numba; empty where they are Python, or use a function that is."""
    from polyida.jit.user_functions import OwnData

    found = {name: getattr(type(part), name) for name in names if writes(part, base, name)}
    return found if part.by_numba and not OwnData(part, found.values()).python else {}


SAME = 1e-9  # of its size, by which what ought to be equal may differ


class Body(OwnPart):
    """A body of one's own, a frozen dataclass with a field `name`: coordinates z (pairs,), complex numbers for pairs (x, y) that move.

    `M z'' + elastic(z) = forces`, M constant; each of its points is `x = sum w_k z_k` with constant complex weights w, so that joints,
    masses, loads and forces hold on to it by `body.at(name)`. In q stand the displacements of its pairs from `coordinates()`, after the
    nodes of the plates. Gravity acts as `M T g`, T its `translation()`. What is constant is asked for once, and kernels take it from there;
    z is to read only. A scene with a body whose `elastic` is Python goes through the integrators' plain paths, which its summaries say;
    with `@polyida.compiled` above the class numba compiles `elastic` and `energy`. So does one of a body whose x and y carry different masses.
    """

    few = True  # its points are made of few coordinates
    turns_only = False  # whether it keeps the directions of its sections of constant length; of its points it may
    plate: Any = None  # whose mesh shows it; `nodal` then tells of its nodes
    left_out: Any = None  # of a reduced plate: what its modes leave out

    velocity: Any = (0.0, 0.0)  # of its centre of mass at the start, m/s; a class may make it a field
    spin: Any = 0.0  # about it, rad/s

    def coordinates(self) -> ArrayLike:
        """z in the reference configuration, (pairs,), complex: places in m, or numbers without unit such as a direction's."""
        raise NotImplementedError

    def mass_matrix(self) -> ArrayLike:
        """M, Hermitian, (pairs, pairs): kinetic energy `z'^H M z' / 2`, J; or real, symmetric, (2 pairs, 2 pairs), on (x_0, y_0, ...)."""
        raise NotImplementedError

    def attachments(self) -> dict[str, ArrayLike]:
        """{name: weights (pairs,) of its point}, or of its point and its direction, (2, pairs), complex."""
        raise NotImplementedError

    def x_axis(self) -> ArrayLike | None:
        """Weights (pairs,) of the body's x axis, the direction of its points where they have none of their own; None: there is none."""
        return None

    def translation(self) -> ArrayLike:
        """T (pairs,): by how much each pair moves where the whole body moves by one. Of the first pair by one, of the others not at all."""
        return np.arange(len(np.atleast_1d(self.coordinates()))) == 0

    def elastic(self, z: NDArray) -> ArrayLike:
        """`dW/dRe z + i dW/dIm z`, (pairs,), complex, W the elastic energy; where it is not written the body is rigid."""
        raise NotImplementedError

    def elastic_z(self, z: NDArray) -> ArrayLike | None:
        """Derivative of `elastic` on (x_0, y_0, x_1, ...), real, (2 pairs, 2 pairs); None: by differences."""
        return None

    def energy(self, z: NDArray) -> float:
        """Elastic energy W, J, zero at rest."""
        raise NotImplementedError

    def compiled_functions(self) -> dict[str, Any]:
        """{"elastic", "energy": function(self, z)} that numba compiles, empty where they are Python."""
        return compiled_functions(self, Body, "elastic", "energy")

    def rows(self) -> list[Row | Vector]:
        """Constraints of its own, as of a joint, made of the `x` and `d` of its points (`self.at`, `self.point_of`): those, say, that keep
        its coordinates rigid.
        """
        return []

    def form(self) -> tuple[ArrayLike, ArrayLike] | None:
        """(form, shift) of a body of K vectors z_i, its pairs from the second on, whose elastic energy is `d^T form d / 2 + shift^T d`
        (K^2, K^2) and (K^2,), d the gain of y = (Re conj(z_i) z_j, i <= j; Im conj(z_i) z_j, i < j) from rest, J; None where it has none.
        Kernels then take it, in place of `elastic`.
        """
        return None

    def damping(self) -> tuple[float, float]:
        """(drag, 1/s, viscosity, s) as of a plate's material: forces `drag M z'` and, of a form, `viscosity (dy/dz)^T form y'`."""
        return 0.0, 0.0

    def settled(self, held: list[Attachment]) -> "Body":
        """The body as a scene takes it, whose parts hold on to these of its attachments: itself, unless its coordinates depend on them."""
        return self

    def made_fields(self, settled: "Body", like: "Body | None" = None) -> dict[str, Any]:
        """Fields of its class that a file keeps of the body as it was `settled`, where that may come out otherwise elsewhere.

        like: another settled body, to which the fields are to be as near as what they span allows.
        """
        return {}

    def weights_of(self, side: Attachment, part: str) -> NDArray:
        """Weights (pairs,), complex, of which an attachment's "point" or "direction" is the sum."""
        return side.weights if part == "point" else side.turn_weights  # type: ignore[return-value]

    def shares_of(self, side: Attachment, forces: NDArray) -> NDArray:
        """What of forces, complex, on the nodes of an attachment, here its pairs, acts on each pair, (pairs,)."""
        return forces

    def nodal(self, moved: NDArray) -> NDArray:
        """Displacements (nodes, 2), m, of the nodes of its plate from those of its pairs, complex."""
        raise NotImplementedError

    def require(self) -> None:
        """Raise InputError unless its class is whole and gives what it must."""
        require_whole(self, Body, ("coordinates", "mass_matrix", "attachments"))
        if writes(self, Body, "elastic") != writes(self, Body, "energy"):
            raise InputError(f"{self.label}: elastic(z) is the slope of energy(z); its class must give both, or none where it is rigid")
        named = self.attachments()
        if not isinstance(named, dict) or not named or not all(isinstance(name, str) and name for name in named):
            raise InputError(f"{self.label}: attachments() gave {str(named)[:80]}; it must give {{name: weights}}, one at least")
        mass_of(self), translation_of(self), form_of(self)

    def at(self, name: str, direction: ArrayLike | None = None) -> "BodyPoint":
        """A point by name. direction: of any length, in the axes of the body at rest turned with its x axis; that axis where it is None.

        Raises InputError for another name, and for a direction where there is no axis.
        """
        known = self.attachments()
        if not is_one_of(name, known):
            raise InputError(f"{self.label}: no attachment is called {name!r}; known: {', '.join(map(repr, known))}")
        return self.point_of(name, known[name], direction)

    def point_of(self, name: str, weights: ArrayLike, direction: ArrayLike | None = None) -> "BodyPoint":
        """A point by its weights, as `attachments()` gives them; name: how messages call it."""
        pairs = len(rest_of(self))
        given = _finite(weights)
        if given is None or given.shape not in ((pairs,), (2, pairs)):
            want = f"its weights, ({pairs},), or those of its point and direction, (2, {pairs})"
            raise InputError(f"{self.label}: attachment {name!r} is given by {str(weights)[:80]}; it must be {want}, finite numbers")
        where, way = given if given.ndim == 2 else (given, self.x_axis())
        if way is None and direction is not None:
            raise InputError(f"{self.label}: attachment {name!r} has no direction to turn to {direction!r}; let the class give x_axis()")
        turn = None if way is None else _turned(self, name, way, direction)
        return BodyPoint(self, np.arange(pairs, dtype=np.int32), where, turn, 0.0, name)


@dataclass(frozen=True, eq=False, repr=False)
class BodyPoint(Attachment):
    """A point of a body of one's own: `x = sum w_i z_i`, `d = sum w'_i z_i`, weights (pairs,) complex, |d| = 1 at rest."""

    turns_only = True
    advice = "let its class give x_axis(), or the attachment a direction of its own"

    @property
    def point(self) -> NDArray:
        """Reference position of the point, (2,), m."""
        return pairs_of(self.weights @ rest_of(self.body))

    @property
    def direction(self) -> NDArray | None:
        """Reference direction, (2,), of length one, or None."""
        return None if self.turn_weights is None else pairs_of(self.turn_weights @ rest_of(self.body))

    def on(self, body: Any) -> "Attachment":
        """The point of the same name of another body like its own, its direction turned as it was: weights may depend on the body's numbers."""
        if self.name not in body.attachments():
            return replace(self, body=body)
        before, after = self.body.at(self.name), body.at(self.name)
        if self.turn_weights is None:
            return after
        k = np.argmax(np.abs(before.turn_weights))
        return replace(after, turn_weights=after.turn_weights * (self.turn_weights[k] / before.turn_weights[k]))

    def share(self, force: ArrayLike) -> NDArray:
        """What of a force (2,) at the point acts on each pair, (pairs, 2)."""
        return pairs_of(self.weights.conj() * (np.asarray(force, float) @ [1.0, 1j]))


def _turned(body, name, way, direction):
    """Weights of a direction of length one at rest, turned from the axis `way` to `direction`."""
    turn, z = 1.0 + 0j, rest_of(body)
    if direction is not None:
        turn = complex(*vector2(f"{body.label}: attachment {name!r}", "direction", direction))
    given = _finite(way)
    if given is None or given.shape != z.shape:
        raise InputError(f"{body.label}: x_axis() gave {str(way)[:80]}; it must be weights, ({len(z)},), finite numbers")
    size = abs(given @ z) * abs(turn)
    if not size > 0:
        raise InputError(f"{body.label}: the direction of attachment {name!r} has no length at rest")
    return given * turn / size


def _finite(given):
    array = complexes(given)
    return array if array is not None and np.isfinite(array).all() else None


def rest_of(body):
    """The coordinates of a body at rest, (pairs,) complex. Raises InputError naming it."""
    given = body.coordinates()
    z = _finite(given)
    if z is None or z.ndim != 1 or not z.size:
        raise InputError(f"{body.label}: coordinates() gave {str(given)[:80]}; it must give a list of finite complex numbers, at least one")
    return z


def mass_of(body):
    """(M, None), M (pairs, pairs) Hermitian, or where x and y carry different masses (None, M), real, on (x_0, y_0, x_1, ...).

    Raises InputError where it is no mass.
    """
    pairs, matrix = len(rest_of(body)), _finite(body.mass_matrix())
    shape = "nothing of the kind" if matrix is None else matrix.shape
    if matrix is None or matrix.shape not in ((pairs, pairs), (2 * pairs, 2 * pairs)):
        raise InputError(
            f"{body.label}: mass_matrix() gave {shape}; it must give finite numbers ({pairs}, {pairs}), or on both of "
            f"each pair ({2 * pairs}, {2 * pairs})"
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
    alike = max(np.abs(xx - yy).max(), np.abs(xy + yx).max()) <= SAME * size
    return (xx + 1j * yx, None) if alike else (None, matrix.real)


def form_of(body):
    """(form, shift) of a body as arrays, or None. Raises InputError for what is none."""
    given = body.form()
    if given is None:
        return None
    form, shift = (floats(part) for part in given)
    size = (len(rest_of(body)) - 1) ** 2
    if form is None or shift is None or form.shape != (size, size) or shift.shape != (size,):
        raise InputError(f"{body.label}: form() must give finite numbers ({size}, {size}) and ({size},)")
    return form, shift


def translation_of(body):
    """Its translation T, (pairs,), complex. Raises InputError unless each of its points moves by T by one, and no direction turns."""
    z = rest_of(body)
    given = _finite(body.translation())
    if given is None or given.shape != z.shape:
        raise InputError(f"{body.label}: translation() must give finite numbers ({len(z)},), how much each pair moves with the whole body")
    for point in points_of(body):
        if abs(point.weights @ given - 1.0) > SAME or (point.has_direction and abs(point.turn_weights @ given) > SAME):
            moved = complex(np.round(point.weights @ given, 9))
            raise InputError(
                f"{body.label}: by translation() {given.tolist()} attachment {point.name!r} moves by {moved:g} "
                "and must move by 1, and its direction by nothing; give the translation() of these coordinates"
            )
    return given


def points_of(body):
    """All of its named points."""
    return [body.at(name) for name in body.attachments()]
