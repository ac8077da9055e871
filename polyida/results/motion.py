"""A run as what is derived from it sees it: angles and reactions of joints, momentum, strain, stress, balance of energy."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.element import kernels
from polyida.errors import InputError
from polyida.io.frames import blocks, each
from polyida.joint.joint import Joint
from polyida.validation import floats, named_keywords


class Motion(NamedTuple):
    """A guarded model, t (frames,), and frames of q, v, a, lam, which may lie in a file."""

    model: Any
    t: NDArray
    q: NDArray
    v: NDArray
    a: NDArray
    lam: NDArray


def angle_of(motion, joint):
    """The turn of a joint's side b against side a, (frames,), rad, unwrapped over the frames."""
    model = motion.model
    joints = {name: model.parts[name] for name in model.joints if isinstance(model.parts[name], Joint)}
    name = next((name for name, part in joints.items() if part is joint), joint)
    if not isinstance(name, str) or name not in joints:
        raise InputError(f"angle: no joint is called {joint!r:.100}; known: {', '.join(map(repr, joints))}")
    return np.unwrap(np.concatenate([model.turn(name, q) for q in blocks(motion.q)]))


def reaction_of(model, name, t, q, lam, whole=False):
    """Of a joint of a scene, or what a model of one's own says: (frames, k), over t (frames,), q (frames, n), lam (frames, m).

    whole: of a scene's joint (fx, fy, m). Of redundant constraints it is that with the least sum of squares of all multipliers.
    """
    if model.redundant:
        lam = model.redundant.multipliers(t, q, lam)
    rows = (model.redundant or model).rows[name]
    return model.reactions(name, q, lam[:, rows], *((t, whole) if model.is_scene else ()))


def momenta_of(motion):
    """(frames, 3): linear momentum x and y, N s, and angular momentum about the origin, N m s. Raises InputError where the model says none."""
    found = [motion.model.momenta(q, v) for q, v in zip(each(motion.q), each(motion.v))]
    if any(values is None for values in found):
        raise InputError(f"momentum: {motion.model.name} does not say it; let its class write momenta(q, v), giving (px, py, L)")
    return np.array(found, float).reshape(-1, 3)


def strains(model, q):
    """Green's strain of every element of a scene at q, (cells, 3): Exx, Eyy, 2 Exy, means over the element at rest, plate after plate."""
    u, parts = model.nodal(q), [np.zeros((0, 3))]
    for body in model.drawn:
        operator = body.operator
        parts.append(np.empty((operator.n_cells, 3)))
        weighed = operator.areas * body.factors[0]
        kernels.green_strain(*operator.force_arrays, operator.lane_cells, weighed, body.nodes.start, u, parts[-1])
    return np.concatenate(parts)


@named_keywords
def von_mises(stress: ArrayLike, zz: ArrayLike = 0.0) -> NDArray:
    """Von Mises stress of Cauchy components (..., 3), xx, yy, xy, and zz (...), same unit:

        sqrt(((xx - yy)^2 + (yy - zz)^2 + (zz - xx)^2) / 2 + 3 xy^2)

    zz is 0 in plane stress; in plane strain it is not, `run.von_mises(frame)` knows it.
    """
    given, out = floats(stress), floats(zz)
    if given is None or not given.ndim or given.shape[-1] != 3:
        raise InputError(f"von_mises: stress = {stress!r} must be finite numbers (..., 3): xx, yy, xy")
    if out is None or out.shape not in ((), given.shape[:-1]):
        raise InputError(f"von_mises: zz = {zz!r} must be a finite number, or one for each of the stresses {given.shape[:-1]}")
    xx, yy, xy = np.moveaxis(given, -1, 0)
    return np.sqrt(((xx - yy) ** 2 + (yy - out) ** 2 + (out - xx) ** 2) / 2 + 3 * xy * xy)


def motor_work(run):
    """Work of all angle motors up to every frame, (frames,), J."""
    from polyida.joint.joints import AngleMotor

    motors = [name for name, joint in run.model.joints.items() if isinstance(joint, AngleMotor)]
    return sum((run.energy.work[name] for name in motors), np.zeros(len(run.t)))


def unbalanced(run):
    """Change of the total energy since the start less the work of all parts, more what they dissipated, (frames,), J.

    NaN where a model states no potential. Zero for the exact motion.
    """
    energy = run.energy
    return energy.total - energy.total[0] - sum(energy.work.values()) + sum(energy.dissipated.values())
