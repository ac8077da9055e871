"""A plate reduced to few modes for large rotations, its exact elastic energy, and modes of a run (POD)."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from polyida.body.body import Body, BodyPoint
from polyida.body.plate import Plate
from polyida.body.plate_modes import PlateMatrices, completed_rows, form_of_fields, independent_rows, modes_of, orthogonal_fields, rows_of
from polyida.body.rigid_body import FieldBody
from polyida.errors import InputError
from polyida.fields import must_be
from polyida.joint.attachment import Attachment
from polyida.linear.saddle import KKT
from polyida.reprs import brief
from polyida.validation import complex_of_pairs, is_one_of, is_whole, named_keywords, pairs_of, reals, settle, whole

if TYPE_CHECKING:
    from polyida.trajectory import Trajectory

MOST = 40  # modes: the form has (modes + 1)^4 numbers
RIGID = 2  # fields of a rigid plate


@named_keywords
@dataclass(frozen=True, eq=False)
class Reduced(FieldBody):
    """A plate with few coordinates: `x = c + z (X - X_S) / s + sum zeta_k f_k`, all complex (n = 4 + 2 modes), s its radius of gyration.

    The complex span of the fields f_k contains every rotated copy of each, so rigid rotations are exact. The elastic energy is that of the
    plate's elements and St. Venant-Kirchhoff law, exact in that span; M is constant; there is no co-rotated frame. Stress, pictures and
    files are those of the plate. Modes of small vibrations do not describe large bending (tip rotation of 0.5 rad: error of 1 % of the
    length with any number of modes): use `pod_modes` of a run of the full plate; a run's summary warns.

    Parameters
    ----------
    plate : Plate
    modes : int, 0 to 40
        Number of modes, by frequency: static modes of the sections, rims and nodes that the scene's parts use (mean x, y and rotation), and
        normal modes with these held. Fewer if the mesh has no more.
    fields : (count, N, 2) float, m, optional
        Additional fields: displacements of the nodes in the axes of the placed plate, e.g. from `pi.pod_modes`.
    stored_fields : (count, N, 2) float, m, optional
        All fields of an earlier run, instead of modes and fields; `pi.load` passes them.
    name : str, optional
        Default: the plate's name.

    Raises
    ------
    InputError
        If `plate` is no Plate, for a wrong number of modes (at least one field is needed), or fields of a wrong shape.

    Notes
    -----
    Generalised component mode synthesis (Gerstmayr and Ambrosio 2008; Pechstein, Reischl and Gerstmayr 2013).
    """

    plate: Plate = field()  # required, although Body has the attribute
    modes: int = field(default=5, metadata=must_be(f"a whole number from 0 to {MOST}", lambda x: is_whole(x, 0, MOST)))
    fields: Any = None
    stored_fields: Any = None
    name: str | None = None

    __repr__ = brief

    def __post_init__(self):
        """Check the fields, and that there is a mode or a field."""
        super().__post_init__()
        label, nodes = self.label, self.plate.mesh.n_nodes
        for key in ("fields", "stored_fields"):
            if (value := getattr(self, key)) is None:
                continue
            array = reals(value)
            if array is None or array.ndim != 3 or array.shape[1:] != (nodes, 2) or not len(array) or not np.isfinite(array).all():
                shape = type(value).__name__ if array is None else array.shape
                raise InputError(f"{label}: fields of shape {shape} must be finite displacements of its nodes, (count, {nodes}, 2)")
            settle(self, **{key: array})
        if not self.modes and self.fields is None:
            raise InputError(f"{label}: modes = 0 leaves no field; give modes, fields, or take Rigid(plate)")

    def prepared(self, attachments: list[Attachment]) -> FieldBody:
        """Return the plate with its modes for these attachments."""
        own, stored = (None if f is None else complex_of_pairs(f).T for f in (self.fields, self.stored_fields))
        return _InModes(self, attachments, own, stored)

    def fields_to_store(self, prepared: Body, like: Body | None = None) -> dict[str, np.ndarray]:
        """Return {"stored_fields": all deformation fields}, the argument of a plate with the very same fields, as real pairs of each field.

        Another computer finds eigenvectors with other signs, or rotated if frequencies coincide. prepared: this body, prepared. like: a
        prepared reduced plate with the same mass matrix and as many modes; the fields are rotated within their span to be nearest to its
        fields. Raises InputError for another number of modes.
        """
        fields = prepared.shapes()[:, RIGID:]  # type: ignore[attr-defined]
        if like is not None:
            others = like.shapes()[:, RIGID:]  # type: ignore[attr-defined]
            if others.shape != fields.shape:
                raise InputError(
                    f"{self.label}: it has {fields.shape[1]} modes in place of {others.shape[1]} where a number of it changes a little"
                )
            left, _, right = np.linalg.svd(fields.conj().T @ (prepared.matrices.mass @ others))  # type: ignore[attr-defined]
            fields = fields @ (left @ right)
        return {"stored_fields": pairs_of(fields.T)}


class _InModes(FieldBody, part=False):
    """A reduced plate in a scene: its fields `f_i^H M f_k = mass delta_ik` with the attachments that its parts use."""

    def __init__(self, reduced, attachments, own, stored):
        """own: additional fields (N, k), complex, or None. stored: all fields but the rigid ones, or None."""
        self.plate, self.name, self.matrices = reduced.plate, reduced.name, PlateMatrices(reduced.plate)
        self.operator = self.matrices.operator
        M, K, places = self.matrices.mass, self.matrices.stiffness, self.plate.placed.points
        ones = np.ones(len(places))
        self.mass = float(ones @ (M @ ones))
        middle = (ones @ (M @ places)) / self.mass
        arms = complex_of_pairs(places - middle)
        self.centre = complex(*(middle + self.plate.origin))
        self._gyration = float(np.sqrt(np.vdot(arms, M @ arms).real / self.mass))
        # static and normal modes: the attachments' mean x, y and rotation are held, completed by rigid motion if the plate is still free
        nodal = [side for side in attachments if not isinstance(side, BodyPoint)]
        rows, self._stretches = rows_of(len(places), nodal)
        C = independent_rows(completed_rows(rows, M, arms, len(nodal) < len(attachments)))
        self._kkt, self._held, self._compliance = KKT(K, C), len(C), None
        if stored is None:
            fields = [np.zeros((len(arms), 0)), *(() if own is None else (own,))]
            if reduced.modes:
                modes = modes_of(K, M, self._kkt, C, arms, reduced.modes)
                fields.insert(0, complex_of_pairs(modes.reshape(-1, 2, modes.shape[1]).transpose(2, 0, 1)).T)
            stored = np.sqrt(self.mass) * orthogonal_fields(M, [ones.astype(complex), arms], np.concatenate(fields, axis=1))
        self._shapes = np.concatenate([np.stack([ones, arms / self._gyration], axis=1), stored], axis=1)
        if self._shapes.shape[1] == RIGID:
            raise InputError(f"{reduced.label}: its fields only move it as rigid; give fields that deform it, modes, or take Rigid(plate)")

    def shapes(self) -> np.ndarray:
        """1, (X - X_S) / s and the modes at the nodes, (N, pairs), complex."""
        return self._shapes

    def coordinates(self) -> np.ndarray:
        """The pairs in the reference configuration, complex, m: (X_S, s, 0, 0, ...)."""
        rest = np.zeros(self._shapes.shape[1], complex)
        rest[:2] = self.centre, self._gyration
        return rest

    def mass_matrix(self) -> np.ndarray:
        """The plate's mass times the identity: all fields have it."""
        return self.mass * np.eye(self._shapes.shape[1])

    @property
    def gyration(self) -> float:
        """Radius of gyration s, m, by the mass matrix of the plate."""
        return self._gyration

    def form(self) -> tuple[np.ndarray, np.ndarray]:
        """(form, shift) of the exact elastic energy in the span of the fields, as `Body.form` describes them."""
        return form_of_fields(self.matrices, self._shapes[:, 1:])

    def damping(self) -> tuple[float, float]:
        """(Rayleigh mass coefficient, 1/s; Kelvin-Voigt time, s) of the plate's material."""
        return self.plate.material.mass_damping, self.plate.material.viscosity

    def prony(self) -> tuple[tuple[float, float], ...]:
        """Terms (g, tau) by which the stress of the plate's material relaxes."""
        return tuple(self.plate.material.prony)  # type: ignore[arg-type]

    def truncation_error(self, moved: np.ndarray, accelerations: np.ndarray, gravity: complex) -> tuple[float, float]:  # type: ignore[override]
        """Return (strain energy, J; displacement, m) that the modes cannot represent: `-d^T r / 2` and the largest |d_i|; see `missing`."""
        r, d = self.missing(moved, accelerations, gravity)
        return float(-0.5 * d @ r), float(np.abs(d).max())

    def missing(self, moved: np.ndarray, accelerations: np.ndarray, gravity: complex) -> tuple[np.ndarray, np.ndarray]:
        """Return (r, d), (2N,) each, in axes that turn with the plate.

        r is the residual of the full plate for these displacements and accelerations of the pairs, complex; d is its linear response with
        the attachments held.
        """
        z, shapes = self.coordinates() + moved, self._shapes
        turn = z[1] / abs(z[1])
        deformed = pairs_of((shapes[:, 1:] @ z[1:]) * turn.conjugate() - self._gyration * shapes[:, 1])
        r = self.matrices.force(deformed) + self.matrices.mass @ pairs_of((shapes @ accelerations - gravity) * turn.conjugate())
        r, none = r.ravel(), np.zeros(self._held)
        d = self._kkt.solve(r, none)[0]
        if len(self._stretches):  # hold the length of the attachments' directions too
            if self._compliance is None:
                self._compliance = np.stack([self._kkt.solve(-row, none)[0] for row in self._stretches], axis=1)
            d = d - self._compliance @ np.linalg.solve(self._stretches @ self._compliance, self._stretches @ d)
        return r, d


FRAMES = 400  # of a run that POD uses, evenly spaced
NOTHING = 1e-12  # of the largest displacement: smaller singular values are round-off


@named_keywords
def pod_modes(run: "Trajectory", name: str, count: int = 5) -> np.ndarray:
    """Return the fields that contain most of a plate's deformation in a run, for `pi.Reduced(plate, fields=...)`.

    The rigid motion nearest in M is subtracted from each frame x, complex: `w = exp(-i theta) (x - x_S) - (X - X_S)`. The fields are the left
    singular vectors of the frames w, orthonormal in M, by decreasing singular value; 400 evenly spaced frames are used.

    Parameters
    ----------
    run : Trajectory
    name : str
        The plate's name.
    count : int, >= 1

    Returns
    -------
    (count, N, 2) float, m
        Displacements of the nodes.

    Raises
    ------
    InputError
        If the run has no such plate or no model, or if its motion has fewer than `count` independent fields.

    Notes
    -----
    Proper orthogonal decomposition by the method of snapshots (Sirovich 1987).
    """
    if hasattr(run, "known_model"):
        run.known_model("pod_modes")
    drawn = {} if getattr(run, "model", None) is None else {body.name: body for body in run.model.drawn}
    if not is_one_of(name, drawn):
        raise InputError(f"pod_modes: the run has no plate {name!r}; known: {', '.join(map(repr, drawn)) or 'none'}")
    whole("pod_modes", "count", count)
    body, moved = drawn[name], []
    weights = _nodal_masses(body.operator, body.plate.order)
    weights = weights / weights.sum()
    rest = complex_of_pairs(body.points)
    rest = rest - weights @ rest
    for k in np.unique(np.linspace(0, len(run) - 1, FRAMES).astype(int)):
        x = complex_of_pairs(run.node_positions(int(k))[body.nodes])
        x = x - weights @ x
        turn = np.vdot(x, weights * rest)
        moved.append(x * turn / abs(turn) - rest)
    roots = np.sqrt(weights)
    fields, sizes, _ = np.linalg.svd(roots[:, None] * np.array(moved).T, full_matrices=False)
    if (independent := int((sizes > NOTHING * np.abs(rest).max()).sum())) < count:
        raise InputError(f"pod_modes: {name!r} has {independent} fields in this run, not {count}; keep more frames, or take fewer")
    return pairs_of((fields[:, :count] / roots[:, None]).T)


SNAPSHOTS = 41  # frames of a run in which missing fields are looked for, evenly spaced


@named_keywords
def missing_fields(run: "Trajectory", name: str, count: int = 3) -> np.ndarray:
    """Return the fields that a reduced plate lacks in a run, for `pi.Reduced(plate, modes=..., fields=...)`.

    In 41 frames the residual of the full plate at the recovered motion is applied to the plate at rest with its attachments held; the fields are the
    left singular vectors of these static corrections, orthonormal in M.

    Parameters
    ----------
    run : Trajectory
    name : str
        Name of the reduced plate.
    count : int, >= 1

    Returns
    -------
    (count, N, 2) float, m
        Displacements of the nodes in the axes of the placed plate.

    Raises
    ------
    InputError
        If the run has no such reduced plate or no model, if the plate is viscoelastic, or if fewer than `count` independent fields are missing.

    Examples
    --------
    >>> better = pi.Reduced(plate, modes=5, fields=pi.missing_fields(run, "rod"))
    """
    if not hasattr(run, "known_model"):
        raise InputError(f"missing_fields: {run!r:.100} is no run; give what solve or load returns")
    model = run.known_model("missing_fields")
    known = {
        one.name: one
        for one in (model.reduced_bodies if model.is_scene else ())
        if isinstance(one.body, _InModes) and one.name not in model.strains
    }
    if not is_one_of(name, known):
        raise InputError(f"missing_fields: no elastic reduced plate is called {name!r}; known: {', '.join(map(repr, known)) or 'none'}")
    whole("missing_fields", "count", count)
    placed, corrections = known[name], []
    for k in np.unique(np.linspace(0, len(run) - 1, SNAPSHOTS).astype(int)).tolist():
        moved, a = (complex_of_pairs(np.asarray(x[k], float).reshape(-1, 2)[placed.pairs]) for x in (run.q, run.a))
        gravity = complex(*(float(g(float(run.t[k])) if callable(g) else g) for g in model.gravity))
        _, d = placed.body.missing(moved, a, gravity)
        corrections.append(complex_of_pairs(d.reshape(-1, 2)))
    matrices = placed.body.matrices
    scale = matrices.plate.material.rho * matrices.plate.thickness
    roots = np.sqrt(scale * _nodal_masses(matrices.operator, matrices.plate.order))
    fields, sizes, _ = np.linalg.svd(roots[:, None] * np.array(corrections).T, full_matrices=False)
    if (independent := int((sizes > NOTHING * (sizes[0] or 1.0)).sum()) if sizes[0] else 0) < count:
        raise InputError(f"missing_fields: {name!r} lacks {independent} fields in this run, not {count}")
    return pairs_of((fields[:, :count] / roots[:, None]).T)


def _nodal_masses(operator, order):
    """Positive masses of the nodes over rho t, (N,): sums of rows; of order 2, where some are negative, in proportion to the diagonal."""
    if order == 1:
        return np.add.reduceat(operator.mass, operator.indptr[:-1])
    own = np.repeat(np.arange(operator.n_nodes), np.diff(operator.indptr)) == operator.indices
    return operator.mass[own] * (operator.mass.sum() / operator.mass[own].sum())
