"""Threads that share the solves of one loop, with one factor after another."""

from contextlib import contextmanager

from polyida.linear.cholesky.factor import FRONTS
from polyida.linear.cholesky.team import at_work, team


class Helpers:
    """`count` threads, this one included; factors on the same fronts have the same team."""

    def __init__(self, count):
        self.count, self.team = count, None

    @contextmanager
    def at_work(self, factor, room):
        """The room of solves with the factor, which are shared within this; as it was where there is one thread, or the factor has no fronts."""
        if self.count == 1 or factor.kind != FRONTS:
            yield room
            return
        self.team = self.team or team(factor.fronts, self.count, factor.panels.dtype)
        with at_work(self.team, factor, room.x):
            yield room._replace(team=self.team)
