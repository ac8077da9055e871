"""The factors that adaptive steps come back to."""

KEPT = 6  # factors that are kept, of the steps h used last


class Kept:
    """The factors of the few steps h that were used last: adaptive steps come back to them."""

    def __init__(self):
        self.factors = {}

    def take(self, h):
        """What is kept of this h, or None."""
        found = self.factors.pop(h, None)
        if found is not None:
            self.factors[h] = found
        return found

    def keep(self, h, factor):
        """Keep a factor, in place of that of the h that has not been used for the longest time."""
        self.factors.pop(h, None)
        self.factors[h] = factor
        while len(self.factors) > KEPT:
            self.factors.pop(next(iter(self.factors)))
