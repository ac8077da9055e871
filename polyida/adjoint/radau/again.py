"""A run of Radau IIA taken again by the very steps that it took, of its model with a parameter changed."""

from polyida.adjoint.alpha.again import Again
from polyida.adjoint.radau.course import course_of
from polyida.adjoint.radau.stages import begun, exact_steps, within
from polyida.integrate.state import Counts


class RadauAgain(Again):
    """As Again, each step solved to round-off."""

    course_of = staticmethod(course_of)

    def _exact(self, settings):
        return settings

    def _taken(self, model, state, times):
        states, engine = [state], exact_steps(model, self.settings, state, float(self.run.t[-1]), Counts())
        for piece in self.course.pieces:
            state, t = begun(model, states[-1]), times(piece.first + 1)
            engine.limits = within(model, state.t, t)
            states.append(engine.step(state, t - state.t, t))
        return states
