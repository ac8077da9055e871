"""Vectors that remember how they were made, so that bars of what came of them go back to what they were made of (reverse accumulation)."""

import numpy as np


class Tape:
    """What was done, in order; `back` goes through it in reverse."""

    def __init__(self):
        self.done = []

    def var(self, value):
        """A vector that others are made of."""
        return Var(self, np.array(value, float))

    def made(self, value, *pulls):
        """A vector made of others: pulls, (Var, function of its bar that gives the other's) each. What is no Var is passed over."""
        found = self.var(value)
        self.done.append((found, [(var, pull) for var, pull in pulls if isinstance(var, Var)]))
        return found

    def noted(self, makers, back):
        """Vectors made together: back takes all of their bars at once, and adds to others' itself. makers: their values."""
        found = [self.var(value) for value in makers]
        self.done.append((found, back))
        return found

    def back(self):
        """Send all bars to where they come from; nothing is left on the tape, so that it keeps no model alive."""
        while self.done:
            found, pulls = self.done.pop()
            if isinstance(found, list):
                if any(var.bar.any() for var in found):
                    pulls(*(var.bar for var in found))
            elif found.bar.any():
                for var, pull in pulls:
                    var.bar = var.bar + pull(found.bar)


class Var:
    """A vector on a tape: value, and bar, the slope of the objective in it. Numbers and arrays may stand beside it in sums."""

    __array_ufunc__ = None  # numpy leaves sums and products to this class

    def __init__(self, tape, value):
        self.tape, self.value, self.bar = tape, value, np.zeros_like(value)

    def __add__(self, other):
        return self.tape.made(self.value + value_of(other), (self, _same), (other, _same))

    def __sub__(self, other):
        return self.tape.made(self.value - value_of(other), (self, _same), (other, np.negative))

    def __rsub__(self, other):
        return self.tape.made(other - self.value, (self, np.negative))

    def __mul__(self, factor):
        return self.tape.made(factor * self.value, (self, lambda bar: factor * bar))

    def __truediv__(self, factor):
        return self * (1.0 / factor)

    def __neg__(self):
        return self * -1.0

    def any(self):
        """True: whether it is zero is not asked of a vector that may move."""
        return True

    __radd__, __rmul__ = __add__, __mul__


def value_of(thing):
    """The numbers of a Var, or what is given."""
    return thing.value if isinstance(thing, Var) else thing


def add_to(thing, bar):
    """Add to the bar of a Var; what is none has no use for it."""
    if isinstance(thing, Var):
        thing.bar = thing.bar + bar


def _same(bar):
    return bar
