"""A plate reduced to few modes that may turn and move by any amount, and fields of a run to reduce it with."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from polyida.body.body import Body
from polyida.body.field_body import FieldBody
from polyida.body.plate import Plate
from polyida.body.reduction import PlateMatrices, basis_of, form_of_fields
from polyida.errors import InputError
from polyida.joint.attachment import Attachment
from polyida.validation import complex_of_pairs, is_one_of, is_whole, named_keywords, pairs_of, reals, settle

if TYPE_CHECKING:
    from polyida.trajectory import Trajectory

MOST = 40  # modes: the form has (modes + 1)^4 numbers
RIGID = 2  # fields of a rigid plate


@named_keywords
@dataclass(frozen=True, eq=False)
class Reduced(FieldBody):
    """A plate in `x = c + z (X - X_S) / s + sum zeta_k f_k`, s its radius of gyration, few complex coordinates (n = 4 + 2 modes a body),
    whatever the number of its cells.

    modes: how many, static modes of the sections, rims and nodes that the scene's parts hold on to (mean x, y and rotation) and
    normal modes of the plate with these held together, by their frequencies; all, where its mesh has no more. fields: of one's own beside
    them, displacements of the nodes in the plate's axes as it is placed, (count, N, 2), m; `pi.pod_modes(run, name, count)` takes them
    from a run. made: all of its fields as they were in the run of a file, (count, N, 2), m, in place of those that would be made anew:
    loading gives it.

    The complex span of the fields holds every turned copy of each, so rigid turns cost nothing and are exact; the elastic energy is that
    of the plate's own elements and St. Venant-Kirchhoff law, exactly, in that span: no co-rotated frame, no geometric stiffness to add, M
    constant. Stress, pictures and files are those of the plate. What it cannot do: modes of small vibrations do not bend far (a plate
    whose tip turns by half a radian is off by a hundredth of its length with any number of them); take fields of a run of the full plate
    then. A run's summary warns.

    Generalised component mode synthesis (Gerstmayr and Ambrosio 2008; Pechstein, Reischl and Gerstmayr 2013). Raises InputError for what is
    no plate, a wrong number of modes (0 to 40, one field at least) and fields of another shape.
    """

    plate: Plate
    modes: int = 5
    fields: Any = None
    made: Any = None
    name: str | None = None

    def __post_init__(self):
        self.require_plate()
        if not is_whole(self.modes, 0, MOST):
            raise InputError(f"{self.label}: modes = {self.modes!r} must be a whole number from 0 to {MOST}")
        for key in ("fields", "made"):
            if getattr(self, key) is not None:
                settle(self, **{key: self._checked(getattr(self, key))})
        if not self.modes and self.fields is None:
            raise InputError(f"{self.label}: modes = 0 leaves no field; give modes, fields, or take Rigid(plate)")

    def _checked(self, given):
        """The fields as (count, N, 2)."""
        array, nodes = reals(given), self.plate.mesh.n_nodes
        if array is None or array.ndim != 3 or array.shape[1:] != (nodes, 2) or not len(array) or not np.isfinite(array).all():
            shape = type(given).__name__ if array is None else array.shape
            raise InputError(f"{self.label}: fields of shape {shape} must be finite displacements of its nodes, (count, {nodes}, 2)")
        return array

    def settled(self, held: list[Attachment]) -> FieldBody:
        """The plate with its modes, told what holds it."""
        matrices = PlateMatrices.of(self.plate)
        basis = basis_of(
            matrices, held, self.modes, *(None if given is None else complex_of_pairs(given).T for given in (self.fields, self.made))
        )
        if basis.shapes.shape[1] == RIGID:
            raise InputError(f"{self.label}: its fields only move it as rigid; give fields that deform it, modes, or take Rigid(plate)")
        return _InModes(self.plate, self.name, matrices, basis)

    def made_fields(self, settled: Body, like: Body | None = None) -> dict[str, NDArray]:
        """All fields of its modes: eigenvectors are the same elsewhere but for a sign, or a turn where frequencies meet.

        like: a reduced plate of the same mass matrix in a scene; the fields are turned within their span to be the nearest to its fields.
        """
        fields = settled.shapes()[:, RIGID:]  # type: ignore[attr-defined]
        if like is not None:
            others = like.shapes()[:, RIGID:]  # type: ignore[attr-defined]
            if others.shape != fields.shape:
                raise InputError(
                    f"{self.label}: it has {fields.shape[1]} modes in place of {others.shape[1]} where a number of it changes a little"
                )
            left, _, right = np.linalg.svd(fields.conj().T @ (settled.matrices.mass @ others))  # type: ignore[attr-defined]
            fields = fields @ (left @ right)
        return {"made": pairs_of(fields.T)}


class _InModes(FieldBody, part=False):
    """The same in a scene."""

    def __init__(self, plate, name, matrices, basis):
        self.plate, self.name, self.matrices, self.basis = plate, name, matrices, basis
        self.operator = matrices.operator

    def shapes(self) -> NDArray:
        """1, (X - X_S) / s and the modes at the nodes, (N, pairs), complex."""
        return self.basis.shapes

    def coordinates(self) -> NDArray:
        """(X_S, s, 0, 0 ...), m."""
        rest = np.zeros(self.shapes().shape[1], complex)
        rest[:2] = self.basis.centre, self.basis.gyration
        return rest

    def mass_matrix(self) -> NDArray:
        """The plate's mass times the identity: all fields have it."""
        return self.basis.mass * np.eye(self.shapes().shape[1])

    @property
    def gyration(self) -> float:
        """The radius of gyration s, m, of the plate's M."""
        return self.basis.gyration

    def form(self) -> tuple[NDArray, NDArray]:
        """The exact energy of the span."""
        return form_of_fields(self.matrices, self.shapes()[:, 1:])

    def left_out(self, moved: NDArray, pulled: NDArray, gravity: complex) -> tuple[float, float]:  # type: ignore[override]
        """(strain energy, J, displacement, m) that the modes leave out where its pairs have moved by `moved` and are accelerated by
        `pulled`, complex: `-d^T r / 2` and the largest of d, by which the residual r of the full plate would move it with what holds it
        kept.
        """
        turn = self._turn(moved)
        pull = (self.shapes() @ pulled - gravity) * turn.conjugate()
        r = self.matrices.force(self._deformed(moved)) + self.matrices.mass @ pairs_of(pull)
        d = self.basis.hold.still(r.ravel())
        return float(-0.5 * d @ r.ravel()), float(np.abs(d).max())

    def _turn(self, moved):
        z = self.gyration + moved[1]
        return z / abs(z)

    def _deformed(self, moved):
        """Displacements (N, 2) of the nodes in the plate's frame."""
        z, turn, shapes = self.coordinates() + moved, self._turn(moved), self.shapes()
        return pairs_of((shapes[:, 1:] @ z[1:]) * turn.conjugate() - self.gyration * shapes[:, 1])

    def damping(self) -> tuple[float, float]:
        """The material's."""
        return self.plate.material.mass_damping, self.plate.material.viscosity


FRAMES = 400  # of a run that are looked at, evenly spread
NOTHING = 1e-12  # of the largest singular value: a field of as little is round-off


@named_keywords
def pod_modes(run: "Trajectory", name: str, count: int = 5) -> NDArray:
    """The `count` fields (count, N, 2), m, that hold most of a plate's deformation in a run, for `pi.Reduced(plate, fields=...)`.

    Of each frame x, complex, the rigid motion nearest in M is taken off, `w = exp(-i theta) (x - x_S) - (X - X_S)`; the fields are the left
    singular vectors of the frames w, of length one in M, most important first. 400 frames are looked at, evenly spread. Source: proper
    orthogonal decomposition by the method of snapshots (Sirovich 1987). Raises InputError where the run has no plate of that name, its
    model is not known, count is no whole number, or the motion has fewer fields.
    """
    if hasattr(run, "known_model"):
        run.known_model("pod_modes")
    drawn = {} if getattr(run, "model", None) is None else {body.name: body for body in run.model.drawn}
    if not is_one_of(name, drawn):
        raise InputError(f"pod_modes: the run has no plate {name!r}; known: {', '.join(map(repr, drawn)) or 'none'}")
    if not is_whole(count):
        raise InputError(f"pod_modes: count = {count!r} must be a whole number of at least 1")
    body, moved = drawn[name], []
    weights = np.add.reduceat(body.operator.mass, body.operator.indptr[:-1])
    weights = weights / weights.sum()
    rest = complex_of_pairs(body.points)
    rest = rest - weights @ rest
    for k in np.unique(np.linspace(0, len(run) - 1, FRAMES).astype(int)):
        x = complex_of_pairs(run.node_positions(int(k))[body.nodes])
        x = x - weights @ x
        turn = np.vdot(x, weights * rest)
        moved.append(x * turn / abs(turn) - rest)
    shares = np.sqrt(weights)
    fields, sizes, _ = np.linalg.svd(shares[:, None] * np.array(moved).T, full_matrices=False)
    if (found := int((sizes > NOTHING * np.abs(rest).max()).sum())) < count:
        raise InputError(f"pod_modes: {name!r} has {found} fields in this run, not {count}; keep more frames, or take fewer")
    return pairs_of((fields[:, :count] / shares[:, None]).T)
