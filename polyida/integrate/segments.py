"""Pieces of a run between the kinks of its loads and motors, so that no step crosses one."""


def segments(model, t0, t_end):
    """[(begin, end)] from t0 to t_end, parted at the model's kinks; kinks within round-off of an end are left out."""
    near = 1e-12 * max(abs(t0), abs(t_end), t_end - t0)
    inner = [t for t in model.kinks(t0, t_end) if t0 + near < t < t_end - near]
    edges = [t0, *inner, t_end]
    return list(zip(edges[:-1], edges[1:]))
