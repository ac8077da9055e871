"""Derivatives of expressions with common parts. sympy differentiates a part each time that it occurs; here each is differentiated once."""

from functools import lru_cache

import sympy as sp

FLAT = (sp.sign, sp.Heaviside, sp.floor, sp.ceiling)  # their slope is zero wherever they have one


class Derivative:
    """The derivative of expressions along a direction, {symbol: its rate}; other symbols are constant.

    contained: {part of an expression: all that it is made of}, which several directions share.
    """

    def __init__(self, rates, contained=None):
        """Take the rates {symbol: its derivative along the direction}; contained: {expression: its symbols}, shared."""
        self._known = dict(rates)
        self._moving = frozenset(rates)
        self._contained = {} if contained is None else contained

    def __call__(self, expression):
        """The derivative of an expression along the direction; each part is derived once."""
        known = self._known.get(expression)
        if known is None:
            depends = not self._moving.isdisjoint(self._leaves(expression))
            known = self._known[expression] = self._derived(expression) if depends else sp.S.Zero
        return known

    def _leaves(self, expression):
        """The symbols in an expression, and what else has a rate."""
        found = self._contained.get(expression)
        if found is None:
            own = (expression,) if not expression.args or expression.is_Function or expression.is_Derivative else ()
            found = self._contained[expression] = frozenset(own).union(*map(self._leaves, expression.args))
        return found

    def _derived(self, expression):
        """The derivative of an expression that depends on what moves: sum, product, power, branch, or the chain rule."""
        arguments = expression.args
        if isinstance(expression, FLAT):
            return sp.S.Zero
        if isinstance(expression, sp.Piecewise):
            return sp.Piecewise(*((self(value), condition) for value, condition in arguments))
        slopes = [(k, slope) for k, one in enumerate(arguments) if (slope := self(one)) is not sp.S.Zero]
        if expression.is_Add:
            return sp.Add(*(slope for _, slope in slopes))
        if expression.is_Mul:
            return sp.Add(*(sp.Mul(*arguments[:k], slope, *arguments[k + 1 :]) for k, slope in slopes))
        if expression.is_Pow and [k for k, _ in slopes] == [0]:
            base, exponent = arguments
            return sp.Mul(exponent, sp.Pow(base, exponent - 1), slopes[0][1])
        stand_ins, partial = _partial(expression.func, len(arguments))
        back = dict(zip(stand_ins, arguments))
        return sp.Add(*(sp.Mul(partial[k].xreplace(back), slope) for k, slope in slopes))


@lru_cache
def _partial(function, count):
    """(stand-ins for the arguments of a function, its derivative in each)."""
    stand_ins = [sp.Dummy(real=True) for _ in range(count)]  # real: otherwise the slope of Abs has parts of complex numbers
    value = function(*stand_ins)
    return stand_ins, [value.diff(one) for one in stand_ins]


def jacobian(expressions, symbols):
    """The derivatives of expressions (k,) in symbols (n,), a list of rows."""
    contained: dict = {}
    columns = [Derivative({symbol: sp.S.One}, contained) for symbol in symbols]
    return [[column(expression) for column in columns] for expression in expressions]


def symmetric_jacobian(expressions, symbols):
    """The derivatives of a gradient (n,) in symbols (n,), a symmetric matrix, of which half is derived."""
    contained: dict = {}
    columns = [Derivative({symbol: sp.S.One}, contained) for symbol in symbols]
    return [[columns[max(i, j)](expressions[min(i, j)]) for j in range(len(symbols))] for i in range(len(symbols))]
