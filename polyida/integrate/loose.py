"""What a failure says of a structure that can move freely: the force elements that do not resist, and the bodies that nothing holds."""

import numpy as np

from polyida.assembly.motion import rigid_motions
from polyida.errors import StepFailure
from polyida.force.controllers import PID, pid_torque
from polyida.force.force_element import ForceElement
from polyida.integrate.sizes import extent

FREE = "the structure can move freely, or nearly so: hold it by joints or a clamp, and draw what hangs near to where it rests"
LOOSE = 1e-11  # smallest singular value, in units of K and phi_q, of the motions of a body that is held
RESISTS = 1e-6  # of force times way: a force element that does less work does not resist a motion


def yielding_elements(loading, q, dq):
    """Text that names the force elements which the motion dq of a mechanism moves and which do not resist it; empty if there are none."""
    model, t = loading.model, loading.t
    size, named = extent(model, q), []
    dq = size / np.abs(dq).max() * dq
    (place, v, _), (moved, change, _) = loading.at_rest(q), loading.at_rest(dq)
    for own in model.own_forces:
        if not isinstance(own.element, ForceElement):
            continue
        x, speeds, way = own.places(place), own.velocities(v), own.velocities(moved)
        force = own.slopes(t, x, speeds, 0.0, 1.0) @ way.ravel() + own.slopes(t, x, speeds, 1.0, 0.0) @ own.velocities(change).ravel()
        force, way = force.reshape(x.shape)[own.own_sides], way[own.own_sides]
        small = RESISTS * np.linalg.norm(way) * max(np.linalg.norm(force), np.abs(loading.slope).max())
        if np.abs(way / own.sizes[own.own_sides]).max() > RESISTS and abs(np.vdot(force, way)) <= small:
            named.append(repr(own.name) + _limit(own, t, x, speeds))
    return f"; this motion is not resisted by {', '.join(named)}" if named else ""


def _limit(own, t, x, v):
    """Text on a PID at its limit, else empty."""
    if not isinstance(own.element, PID):
        return ""
    whole, torque, *_ = pid_torque(own.element, t, x[own.own_sides], v[own.own_sides], *own.all_states(t, x, v))
    return f", which is at its limit of {own.element.limit:.6g} N m" if whole != torque else ""


def naming_loose(failure, loading, q):
    """The failure of a structure that can move freely, with the bodies that can move while all others stand still."""
    model = loading.model
    if not (model.is_scene and failure.reason.startswith(FREE)):
        return failure
    K, B, motions = loading.stiffness(q, np.zeros(model.m)), model.phi_q(loading.t, q), rigid_motions(model, q).tocsc()
    loose = []
    for k, body in enumerate(model.all_bodies):
        own = motions[:, 3 * k : 3 * k + 3].toarray()
        own /= np.maximum(np.linalg.norm(own, axis=0), 1e-300)
        if np.linalg.svd(np.concatenate([K @ own / (abs(K).max() or 1.0), B @ own]), compute_uv=False)[-1] < LOOSE:
            loose.append(body.name)
    names = ", ".join(map(repr, loose[:3])) + ", ..." * (len(loose) > 3)
    return StepFailure(failure.status, f"{names}: {failure.reason}", failure.t, **failure.seen) if loose else failure
