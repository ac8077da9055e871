"""Energy balance of a run: what the motors put in, and what is gained or lost beside that."""

import numpy as np


def motor_work(run):
    """Work of all angle motors up to every frame, `sum int torque theta' dt`, (frames,), J.

    By the trapezoidal rule.
    """
    from polyida.joint.angle_motor import AngleMotor

    work = np.zeros(len(run.t))
    for name, joint in run.model.joints.items():
        if isinstance(joint, AngleMotor):
            torque = run.reaction(name)[:, 0]
            power = torque * [joint.angle.d1(t) for t in run.t]
            work[1:] += np.cumsum(np.diff(run.t) * (power[1:] + power[:-1]) / 2)
    return work


def unbalanced(run):
    """Change of the total energy since the start less the work of the motors, (frames,), J.

    NaN where a model states no potential. Zero for the exact motion of a scene without damping whose only load is
    gravity.
    """
    total = run.energy.total
    return total - total[0] - motor_work(run)
