"""The part of vibrations whose phase is lost in the error of time steps, and the largest share that it may have in a sum.

Time steps lose the phase of modes with `omega^3 h^2 T / 12 > 1`. tau, what Newmark's formulas leave (alpha_errors.py), less its linear fit
in time, weighted by a Gaussian of width `(h^2 T / 12)^(1/3)`, is the part of these modes. As their phase is unknown, their share in a sum
`factors . tau` is the largest that this part has when it is shifted by up to half a period of the slowest of them: the sum is taken at LAGS
shifts.
"""

import numpy as np

from polyida.jit import entry, fast

WIDTHS = 3.0  # of the Gaussian, on each side; half a period of a mode with omega = 1 / width has pi
LAGS = 25  # shifts of the part of the modes whose phase is lost, an odd number
TOGETHER = 128  # coordinates that are averaged at once


@entry
def add_shifted(steps, tau, factors, first, last, ends, sums):
    """sums (LAGS,) -= `factors . fast`, summed over the steps k from first to last - 1: factors of k, fast of the step at each lag from k.

    fast: tau less its linear fit in time. steps: tuple of middle of each step, its length, and width of the Gaussian, (count,) each.
    tau, factors (2, count, n): the fits are those of tau[0] / h^4 and tau[1] / h^3. The lags are from -WIDTHS to WIDTHS widths; one that
    leaves the steps adds nothing. If the run `ends` with the steps, fast is continued there by its odd image, without a jump or kink: the
    factors of an objective at the end are large there and cancel only in the sum with a smooth fast.
    """
    times, lengths, _ = steps
    at, image, low, high = steps_at_lags(steps, first, last, ends)
    near, shares = shares_of_fits(steps, low, high)
    n, end, fast_part = tau.shape[2], times.shape[0] - 1, np.empty((2, high - low, TOGETHER))
    for begin in range(0, n, TOGETHER):  # as many coordinates as stay in the processor's cache
        size = min(TOGETHER, n - begin)
        subtract_fits(tau[:, :, begin : begin + size], low, near, shares, fast_part)
        own = factors[:, :, begin : begin + size]
        for k in range(first, last):
            for lag in range(LAGS):
                j = at[k - first, lag]
                if j >= 0 and image[k - first, lag]:
                    sums[lag] += product(own, fast_part, k, j, low, lengths) - 2.0 * product(own, fast_part, k, end, low, lengths)
                elif j >= 0:
                    sums[lag] -= product(own, fast_part, k, j, low, lengths)


@fast
def steps_at_lags(steps, first, last, ends):
    """(the step at each lag of steps first to last - 1, -1 for none; True for its odd image; the first and last + 1 of all these steps)."""
    times, lengths, widths = steps
    at, image = np.empty((last - first, LAGS), np.int64), np.zeros((last - first, LAGS), np.bool_)
    low, high, end = first, last, times.shape[0] - 1
    for k in range(first, last):
        for lag in range(LAGS):
            time = times[k] + WIDTHS * widths[k] * (2.0 * lag / (LAGS - 1) - 1.0)
            if ends and time > times[end]:
                image[k - first, lag], time, high = True, 2.0 * times[end] - time, end + 1
            j = min(np.searchsorted(times, time), end)
            j -= j > 0 and time - times[j - 1] < times[j] - time
            at[k - first, lag] = j if abs(time - times[j]) <= lengths[j] else -1
            low, high = min(low, j), max(high, j + 1)
    return at, image, low, high


@fast
def shares_of_fits(steps, low, high):
    """(first and last + 1 of the steps in the fit of each step from low to high - 1; their shares in it for q and v, (2, steps,
    longest)).
    """
    times, lengths, widths = steps
    near, longest = np.empty((high - low, 2), np.int64), 0
    for k in range(low, high):
        near[k - low, 0], near[k - low, 1] = nearest(times, k, widths[k])
        longest = max(longest, near[k - low, 1] - near[k - low, 0])
    shares = np.empty((2, high - low, longest))
    for k in range(low, high):
        begin, end, sum_0, sum_1, sum_2 = near[k - low, 0], near[k - low, 1], 0.0, 0.0, 0.0
        for j in range(begin, end):
            s = (times[j] - times[k]) / widths[k]
            g = np.exp(-0.5 * s * s) * lengths[j]
            sum_0, sum_1, sum_2 = sum_0 + g, sum_1 + g * s, sum_2 + g * s * s
        weight = sum_0 * sum_2 - sum_1 * sum_1
        for j in range(begin, end):
            s, ratio = (times[j] - times[k]) / widths[k], lengths[k] / lengths[j]
            g = np.exp(-0.5 * s * s) * lengths[j] * ((sum_2 - sum_1 * s) / weight if end - begin > 1 else 1.0 / sum_0)
            shares[0, k - low, j - begin], shares[1, k - low, j - begin] = g * ratio**4, g * ratio**3
    return near, shares


@fast
def nearest(times, middle, width):
    """First and last + 1 number of the times within WIDTHS widths of a step's, the number `middle`."""
    first, last = middle, middle + 1
    while first > 0 and times[middle] - times[first - 1] <= WIDTHS * width:
        first -= 1
    while last < times.shape[0] and times[last] - times[middle] <= WIDTHS * width:
        last += 1
    return first, last


@fast
def subtract_fits(tau, low, near, shares, fast_part):
    """Fill fast_part (2, steps, .) with tau (2, ., .) less its fits, of the steps from low on; near, shares: of `shares_of_fits`."""
    for k in range(near.shape[0]):
        for e in range(2):
            out = fast_part[e, k]
            for i in range(tau.shape[2]):
                out[i] = tau[e, low + k, i]
            for j in range(near[k, 0], near[k, 1]):
                share = shares[e, k, j - near[k, 0]]
                for i in range(tau.shape[2]):
                    out[i] -= share * tau[e, j, i]


@fast
def product(factors, fast_part, step, other, low, lengths):
    """The number factors (2, ., .) of `step` times fast_part of step `other`, as this would be with the length of `step`.

    low: number of the first step in fast_part. lengths: of all steps.
    """
    result = 0.0
    for e in range(2):
        total = 0.0
        for i in range(factors.shape[2]):
            total += factors[e, step, i] * fast_part[e, other - low, i]
        result += (lengths[step] / lengths[other]) ** (4 - e) * total
    return result
