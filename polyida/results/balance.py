"""Energy balance of a run: what the motors put in, and what is gained or lost beside all that is known."""

import numpy as np


def motor_work(run):
    """Work of all angle motors up to every frame, (frames,), J."""
    from polyida.joint.angle_motor import AngleMotor

    motors = [name for name, joint in run.model.joints.items() if isinstance(joint, AngleMotor)]
    return sum((run.energy.work[name] for name in motors), np.zeros(len(run.t)))


def unbalanced(run):
    """Change of the total energy since the start less the work of all parts, more what they dissipated, (frames,), J.

    NaN where a model states no potential. Zero for the exact motion.
    """
    energy = run.energy
    return energy.total - energy.total[0] - sum(energy.work.values()) + sum(energy.dissipated.values())
