"""The method of moving asymptotes of nlopt in stages of increasingly sharp projection."""

import math

from polyida.errors import InputError

REST = (
    (5.0, None, 20),
    (10.0, 4.0, 16),
    (20.0, 8.0, 16),
    (20.0, 16.0, 16),
    (20.0, 32.0, 16),
)  # q of RAMP, beta of the projection, evaluations
MOTION = {"full": ((20.0, 16.0, 42), (20.0, 32.0, 42)), "short": ((20.0, 16.0, 16), (20.0, 32.0, 12))}
VOLUME = 0.45
STOPPED = 1e3  # times the first value: what a design counts as whose run stops, so that the optimiser turns back


def minimised(densities, value, stages, x, volume=VOLUME):
    """(variables, densities at the end of each stage, values of all evaluations, final value) from the start x.

    value(rho, q): (a positive value, its slopes in rho); ArithmeticError if a run stops. The logarithm of the value is minimised, so that
    steps do not depend on its unit. volume: upper bound of the mean of rho over the area.
    """
    nlopt, history, designs = _nlopt(), [], []
    for q, beta, evaluations in stages:
        mma = nlopt.opt(nlopt.LD_MMA, len(x))
        mma.set_lower_bounds(0.0)
        mma.set_upper_bounds(1.0)
        mma.set_maxeval(evaluations)
        mma.set_min_objective(_objective(densities, q, beta, value, history))
        mma.add_inequality_constraint(_constraint(densities, beta, volume), 1e-6)
        x = mma.optimize(x)
        designs.append(densities.of(x, beta)[0])
    return x, designs, history, math.exp(mma.last_optimum_value())


def _objective(densities, q, beta, value, history):
    def objective(x, slope):
        rho, rate = densities.of(x, beta)
        try:
            result, slopes = value(rho, q)
        except ArithmeticError:
            result, slopes = STOPPED * history[0], 0.0 * rho
        history.append(result)
        slope[:] = densities.blur.T @ (slopes * rate) / result
        return math.log(result)

    return objective


def _constraint(densities, beta, volume):
    def constraint(x, slope):
        rho, rate = densities.of(x, beta)
        slope[:] = densities.blur.T @ (densities.share * rate)
        return float(densities.share @ rho) - volume

    return constraint


def _nlopt():
    try:
        import nlopt
    except ImportError:
        raise InputError("designed_in_motion: the optimiser is missing: pip install 'polyida[design]'") from None
    return nlopt
