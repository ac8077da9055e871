"""What joints do to their sides b, over frames of a run or at a state."""


def reaction_of(model, name, t, q, lam, whole=False):
    """Of a joint of a scene, or what a model of one's own says: (frames, k), over t (frames,), q (frames, n), lam (frames, m).

    whole: of a scene's joint (fx, fy, m). Of redundant constraints it is that with the least sum of squares of all multipliers.
    """
    if model.redundant:
        lam = model.redundant.multipliers(t, q, lam)
    rows = (model.redundant or model).rows[name]
    return model.reactions(name, q, lam[:, rows], *((t, whole) if model.is_scene else ()))
