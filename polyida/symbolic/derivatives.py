"""Derivatives of expressions with common parts. sympy differentiates a part each time that it occurs; here each is differentiated once."""

import sympy as sp

FLAT = (sp.sign, sp.Heaviside, sp.floor, sp.ceiling)  # their slope is zero wherever they have one


class Derivative:
    """The derivative of expressions along a direction, {symbol: its rate}; other symbols are constant."""

    def __init__(self, rates):
        self._known = dict(rates)

    def __call__(self, expression):
        known = self._known.get(expression)
        if known is None:
            known = self._known[expression] = self._derived(expression)
        return known

    def _derived(self, expression):
        arguments = expression.args
        if not arguments:
            return sp.S.Zero
        if isinstance(expression, sp.Piecewise):
            return sp.Piecewise(*((self(value), condition) for value, condition in arguments))
        slopes = [self(one) if isinstance(one, sp.Expr) else sp.S.Zero for one in arguments]
        moving = [k for k, slope in enumerate(slopes) if slope is not sp.S.Zero]
        if not moving or isinstance(expression, FLAT):
            return sp.S.Zero
        if expression.is_Add:
            return sp.Add(*(slopes[k] for k in moving))
        if expression.is_Mul:
            return sp.Add(*(sp.Mul(*arguments[:k], slopes[k], *arguments[k + 1 :]) for k in moving))
        if expression.is_Pow and moving == [0]:
            base, exponent = arguments
            return sp.Mul(exponent, sp.Pow(base, exponent - 1), slopes[0])
        stand_ins = [sp.Dummy(real=True) for _ in arguments]  # real: otherwise the slope of Abs has parts of complex numbers
        function, back = expression.func(*stand_ins), dict(zip(stand_ins, arguments))
        return sp.Add(*(sp.Mul(function.diff(stand_ins[k]).xreplace(back), slopes[k]) for k in moving))


def jacobian(expressions, symbols):
    """The derivatives of expressions (k,) in symbols (n,), a list of rows."""
    columns = [Derivative({symbol: sp.S.One}) for symbol in symbols]
    return [[column(expression) for column in columns] for expression in expressions]
