"""The order of the step that IDA is trying, told from what it predicts: IDA gives it, and its cj, to nobody before the residual."""

import numpy as np

MOST = 5  # order of a backward differentiation formula, at most
LEADS = np.cumsum(1 / np.arange(1, MOST + 1)).tolist()  # cj h of the orders, whatever the steps before
SHORTEST = float(np.finfo(float).tiny)  # s


class Predicted:
    """One number told of every accepted q, (n,): its product with a vector of no direction in particular.

    In a step of order k IDA begins with the polynomial through the last k + 1 accepted states.
    """

    def __init__(self, n, most):
        self.vector, self.most = np.random.default_rng(0).uniform(0.5, 1.5, n), most
        self.times, self.differences = [], []

    def begin(self, t, q):
        """Nothing but the state at t is known: IDA starts with order 1."""
        self.times, self.differences = [t], [float(self.vector @ q)]

    def accept(self, t, q):
        """A step ended with q at t; one that is lost in the round-off of t tells nothing."""
        if t == self.times[0]:
            return
        times, differences = [t, *self.times[: self.most]], [float(self.vector @ q)]
        for earlier, before in zip(times[1:], self.differences):
            differences.append((differences[-1] - before) / (t - earlier))
        self.times, self.differences = times, differences

    def order(self, t, q):
        """The order whose prediction for t is nearest to q."""
        seen, value, product, found, nearest = float(self.vector @ q), self.differences[0], 1.0, 1, np.inf
        for k in range(1, len(self.times)):
            product *= t - self.times[k - 1]
            value += product * self.differences[k]
            if abs(value - seen) < nearest:
                found, nearest = k, abs(value - seen)
        return found

    def cj(self, t, q):
        """The cj of a step to t."""
        return LEADS[self.order(t, q) - 1] / max(t - self.times[0], SHORTEST)
