"""A Lagrangian as a sum of products, where that is short: terms that cancel in the equations of motion then meet, and derivatives are sparse."""

from math import comb, prod

import sympy as sp

LONGEST = 20_000  # terms of a sum that is written out
WORTH = 4  # times the size of the expression itself


def as_sum(expression, constants):
    """(the expression as a sum of products with different constants c0, c1, ..., {c0: its meaning, ...}), or itself and {} if the sum is long.

    constants: symbols of which c0, c1, ..., are made. A model evaluates these once.
    """
    if _terms(expression) > LONGEST:
        return expression, {}
    coefficients: dict = {}
    for term in sp.Add.make_args(sp.expand(expression, power_base=False, power_exp=False, log=False)):
        factors = sp.Mul.make_args(term)
        moving = sp.Mul(*(factor for factor in factors if not factor.free_symbols <= constants))
        coefficients.setdefault(moving, []).append(sp.Mul(*(factor for factor in factors if factor.free_symbols <= constants)))
    sums = _without_squares({product: sp.Add(*parts) for product, parts in coefficients.items()})
    names: dict = {}
    terms = []
    for product, coefficient in sums.items():
        negative = coefficient.could_extract_minus_sign()
        meaning = -coefficient if negative else coefficient
        if not meaning.is_Number:
            meaning = names.setdefault(meaning, sp.Symbol(f"c{len(names)}", real=True))
        terms.append(sp.Mul(-1 if negative else 1, meaning, product))
    result = sp.Add(*terms)
    return (result, {name: meaning for meaning, name in names.items()}) if _size(result) <= WORTH * _size(expression) else (expression, {})


def _terms(expression):
    """The number of terms that an expression would have if it were multiplied out."""
    if expression.is_Add:
        return sum(map(_terms, expression.args))
    if expression.is_Mul:
        return prod(map(_terms, expression.args))
    if expression.is_Pow and expression.exp.is_Integer and expression.exp > 1:
        terms = _terms(expression.base)
        return comb(terms + int(expression.exp) - 1, terms - 1)
    return 1


def _without_squares(sums):
    """{product: coefficient} of a sum in which `c f sin(a)^2 + c f cos(a)^2` is replaced by `c f`."""
    result = dict(sums)
    for product in sums:
        for factor in sp.Mul.make_args(product):
            if not (factor.is_Pow and factor.exp == 2 and isinstance(factor.base, sp.sin)):
                continue
            others = product / factor
            partner = others * sp.cos(*factor.base.args) ** 2
            if product in result and result.get(partner) == result[product]:
                result[others] = result.get(others, sp.S.Zero) + result.pop(product)
                del result[partner]
    return result


def _size(expression):
    """The number of different subexpressions of an expression."""
    seen, waiting = set(), [expression]
    while waiting:
        part = waiting.pop()
        if part not in seen:
            seen.add(part)
            waiting += part.args
    return len(seen)
