"""Python functions from expressions: what occurs twice, in any entry of a result, is computed once."""

import numpy as np
import sympy as sp
from sympy.printing.codeprinter import PrintMethodNotImplementedError
from sympy.printing.pycode import PythonCodePrinter

MOST = 1000  # a larger exponent is no multiplication


class Unprintable(Exception):
    """An expression contains what Python's math does not know; the text is that part."""


class Printer(PythonCodePrinter):
    """Prints expressions with names in place of those that have one: sums and products in the order of sympy, without its search for signs."""

    def __init__(self):
        """Make a printer of Python code without names for expressions."""
        super().__init__({"order": "none", "fully_qualified_modules": True})
        self.names, self._not_supported, self._number_symbols = {}, set(), set()

    def _print(self, expression, **options):
        """The name of an expression if it has one, otherwise its printed text."""
        return self.names.get(expression) or super()._print(expression, **options)

    def _factor(self, expression):
        """The text of a factor of a product, in brackets unless it is a name, a symbol, a function or a whole number."""
        text = self._print(expression)
        single = expression in self.names or expression.is_Symbol or expression.is_Function and not isinstance(expression, sp.Piecewise)
        return text if single or text.isdigit() else f"({text})"

    def _print_Add(self, expression):
        """The text of a sum: its summands in sympy's order, with " + " between them."""
        return " + ".join(map(self._print, expression.args))

    def _print_Mul(self, expression):
        """A product; a number alone before it becomes a sign or a factor before the text of the rest."""
        number, rest = numbered(expression)
        if rest is not expression:
            text = self._factor(rest) if rest in self.names or not rest.is_Mul else self._print_Mul(rest)
            return f"-{text}" if number is sp.S.NegativeOne else f"{self._factor(number)}*{text}"
        return "*".join(map(self._factor, expression.args))

    def _print_Pow(self, expression, rational=False):
        """A power: 1/x, a whole power as `x**n`, another one as sympy prints it."""
        base, exponent = expression.args
        if exponent is sp.S.NegativeOne:
            return f"1/{self._factor(base)}"
        if exponent.is_Integer and abs(exponent) <= MOST:
            return f"{self._factor(base)}**{self._factor(exponent)}"
        return super()._print_Pow(expression, rational)

    def text(self, expression):
        """The Python text of an expression. Raises Unprintable for what Python code cannot contain."""
        try:
            return self._print(expression)
        except PrintMethodNotImplementedError as error:
            raise Unprintable(str(error).partition("\n")[0]) from None


def numbered(expression):
    """(number, other factors) of a product; (1, itself) of one without a number."""
    number, *others = expression.args
    if not number.is_Number:
        return sp.S.One, expression
    return number, others[0] if len(others) == 1 else sp.Mul._from_args(others)


def parts_of(expressions):
    """(the parts that occur in several places, each behind its own parts; the symbols). What a branch alone has is computed in the branch."""
    seen, repeated, order, symbols = set(), set(), [], set()

    def visit(part, outside):
        """Note a part at its first place, behind its own parts, and as repeated at a second one; outside: not within a branch."""
        if not part.args:
            symbols.add(part)
        elif part not in seen:
            inside = outside and not isinstance(part, sp.Piecewise)
            seen.update({part} if outside else ())
            number, rest = numbered(part) if part.is_Mul else (None, part)
            for one in part.args if rest is part else (rest,):  # what differs in a number alone is one part
                visit(one, inside)
            order.append(part)
        else:
            repeated.add(part)

    for expression in expressions:
        visit(expression, True)
    return [part for part in order if part in repeated], symbols


def text_of_function(name, arguments, entries, shape, names):
    """Source text of a method that returns an array of a shape, () for a number, filled with expressions. Raises Unprintable.

    entries: in the order of the array. names: {symbol: source text of its value}; those that occur are read first.
    """
    common, symbols = parts_of(entries)
    lines = [f"def {name}({', '.join(['self', *arguments])}):"]
    lines += [f"    {symbol} = {text}" for symbol, text in names.items() if symbol in symbols]
    printer = Printer()
    for number, part in enumerate(common):
        lines.append(f"    w{number} = {printer.text(part)}")
        printer.names[part] = f"w{number}"
    if not shape:
        return "\n".join([*lines, f"    return {printer.text(entries[0])} + 0.0", ""])
    lines.append(f"    out = np.zeros({len(entries)})")  # one index is compiled in half the time of a pair
    rows, n = [*np.ndindex(*shape)], shape[-1]
    symmetric = shape == (n, n) and n > 1 and all(entries[i * n + j] == entries[j * n + i] for i in range(n) for j in range(i))
    for place, (index, entry) in enumerate(zip(rows, entries)):
        if entry != 0 and not (symmetric and index[0] > index[1]):
            lines.append(f"    out[{place}] = {printer.text(entry)}")
    if symmetric:
        lines += [f"    for i in range({n}):", "        for j in range(i):", f"            out[i*{n} + j] = out[j*{n} + i]"]
    return "\n".join([*lines, f"    return out.reshape({shape})" if len(shape) > 1 else "    return out", ""])
