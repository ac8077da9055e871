"""How a step can end, as compiled loops tell it, and what a failure says of it."""

# constants of compiled code
DONE, REFACTOR, INVERTED, NOT_FINITE, HALF_TURN, SINGULAR, TOO_FAR, TOO_NEAR, RAISED, WRONG_SHAPE, NO_MATRIX = range(11)
REASONS = {
    REFACTOR: ("newton", "Newton does not converge with fresh matrices"),
    INVERTED: ("inverted", "an element is turned inside out; St. Venant-Kirchhoff has collapsed in compression"),
    NOT_FINITE: ("not finite", "the motion is not finite"),
    HALF_TURN: ("half-turn", "a motor stands on the wrong half-turn"),
    RAISED: ("exception", "a compiled function of the model raised an exception"),
    WRONG_SHAPE: ("shape", "a compiled function of the model returned an array of a wrong shape"),
    NO_MATRIX: ("singular", "the iteration matrix is not finite"),
    SINGULAR: ("singular", "the constraints' system is singular"),
}
