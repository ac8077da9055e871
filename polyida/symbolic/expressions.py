"""From a user's expressions to those of a model: symbols for t, q, v, a, lam, x and the values, and checks of what is given."""

from collections.abc import Mapping
from contextlib import suppress

import sympy as sp
from sympy.core.function import AppliedUndef, UndefinedFunction

from polyida.errors import InputError
from polyida.profile import Profile, as_profile
from polyida.validation import is_number

MOST = 2  # derivatives of a function of time that a profile has
T = sp.Symbol("t", real=True)
WORDS = {0: "coordinates", 1: "velocities", 2: "accelerations"}


def entries(part, name, value):
    """The entries of a list, a tuple or a matrix. Raises InputError."""
    if not isinstance(value, (sp.Basic, str, Mapping)) or isinstance(value, sp.MatrixBase):
        with suppress(TypeError, RuntimeError):
            return list(value)
    raise InputError(f"{part}: {name} = {value!r:.80} must be a list of expressions")


def listed(part, name, value):
    """A list of expressions from a list, a tuple or a matrix with one column. Raises InputError."""
    return [expression_of(part, f"{name}[{k}]", one) for k, one in enumerate(entries(part, name, value))]


def rows_of(part, name, value):
    """The rows of a matrix, or of a list of lists, of expressions, as a list of lists.

    Raises InputError, with part and name in its message.
    """
    rows = value.tolist() if isinstance(value, sp.MatrixBase) else entries(part, name, value)
    return [listed(part, f"{name}[{k}]", row) for k, row in enumerate(rows)]


def expression_of(part, name, value):
    """`value` as a sympy expression: of an equation its left side less the right one.

    Raises InputError, with part and name in its message, unless it is real and finite.
    """
    try:
        expression = sp.sympify(value, strict=True)
    except (sp.SympifyError, TypeError):
        raise InputError(f"{part}: {name} = {value!r:.80} must be an expression of sympy") from None
    if isinstance(expression, sp.Equality):
        expression = expression.lhs - expression.rhs
    if not isinstance(expression, sp.Expr) or isinstance(expression, sp.MatrixBase) or expression.has(sp.nan, sp.zoo, sp.oo, -sp.oo, sp.I):
        raise InputError(f"{part}: {name} = {short(value)} must be a real, finite expression of sympy")
    return expression


def short(expression):
    """An expression as a text for a message, shortened."""
    text = str(expression)
    return text if len(text) <= 120 else f"{text[:100]} ... ({len(text)} characters)"


class Symbols:
    """The symbols of a model for what the user's expressions are made of.

    q, x: the user's coordinates and states, functions of one time. values: {symbol or function of time: number, profile or function}.
    """

    def __init__(self, part, q, states, values):
        """Check coordinates and states, and make the model's symbol for each of them and their derivatives."""
        self.part = part
        self.user_q = [self._coordinate("q", k, one) for k, one in enumerate(q)]
        self.user_x = [self._coordinate("states", k, one) for k, one in enumerate(states)]
        if not self.user_q:
            raise InputError(f"{part}: q = {q!r} must have a coordinate at least")
        both = [*self.user_q, *self.user_x]
        if len(set(both)) < len(both):
            raise InputError(f"{part}: q = {short(both)} names a coordinate or state twice")
        self.user_t = self.user_q[0].args[0]
        if other := [one for one in both if one.args != (self.user_t,)]:
            raise InputError(f"{part}: {other[0]} must be a function of {self.user_t}, as {self.user_q[0]} is")
        n = len(self.user_q)
        self.q, self.v, self.a = (sp.symbols(f"{letter}:{n}", real=True) for letter in "qva")
        self.x = sp.symbols(f"x:{len(self.user_x)}", real=True)
        self._replaced = {self.user_t: T}
        for k, one in enumerate(self.user_q):
            rates = one, one.diff(self.user_t), one.diff(self.user_t, 2)
            self._replaced |= dict(zip(rates, (self.q[k], self.v[k], self.a[k])))
        self._replaced |= dict(zip(self.user_x, self.x))
        self._read_values(values)
        self.used = set()

    def _coordinate(self, name, k, one):
        """Return one entry of a coordinate list, `name[k]`. Raises InputError unless it is a function of time."""
        if not (isinstance(one, AppliedUndef) and len(one.args) == 1 and one.args[0].is_Symbol):
            raise InputError(f"{self.part}: {name}[{k}] = {one!r:.80} must be a function of time, as dynamicsymbols gives it")
        return one

    def _read_values(self, values):
        """parameters: {name: (the user's symbol, ours, the value)}; functions: {f(t): [ours, and those of its derivatives]}; profiles: of these."""
        if not isinstance(values, Mapping):
            raise InputError(f"{self.part}: values = {values!r:.80} must be a dictionary {{symbol: value}}")
        self.parameters, self.functions, self.profiles = {}, {}, []
        for key, value in values.items():
            key = key(self.user_t) if isinstance(key, UndefinedFunction) else key
            if isinstance(key, AppliedUndef) and key.args == (self.user_t,) and key not in self._replaced:
                ours = [sp.Symbol(f"f{len(self.functions)}_{order}", real=True) for order in range(MOST + 2)]
                self._replaced |= {key.diff(self.user_t, order) if order else key: one for order, one in enumerate(ours)}
                self.functions[key] = ours
                self.profiles.append(as_profile(value, f"{self.part}: values[{key}]"))
                continue
            if not (isinstance(key, sp.Symbol) and key != self.user_t):
                raise InputError(f"{self.part}: values has {key!r:.80}, which is no symbol and no function of {self.user_t}")
            name, count = key.name, 1
            while name in self.parameters:  # symbols that differ in their assumptions, and dummies, may have one name
                count += 1
                name = f"{key.name}_{count}"
            self.parameters[name] = key, sp.Symbol(f"p{len(self.parameters)}", real=True), number_of(self.part, key, value)
        self._replaced |= {key: ours for key, ours, _ in self.parameters.values()}

    def __getstate__(self):
        """Pickle all fields but the profiles, which the model stores."""
        return vars(self) | {"profiles": []}

    def rates_of_functions(self):
        """{symbol: that of its derivative in time}, of t and the functions of time; the last ones have none."""
        return {T: sp.S.One} | {one: following for ours in self.functions.values() for one, following in zip(ours, ours[1:])}

    def past(self):
        """Symbols of the highest derivatives of functions of time, which no profile has: they stand where equations need them."""
        return {ours[-1] for ours in self.functions.values()}

    def names(self):
        """{symbol: source text of its value in a function of the model}."""
        groups = {"q": self.q, "v": self.v, "a": self.a, "x": self.x}
        result = {T: "t"} | {one: f"{letter}[{k}]" for letter, group in groups.items() for k, one in enumerate(group)}
        result |= {ours: f"self.values[{k}]" for k, (_, ours, _) in enumerate(self.parameters.values())}
        return result | {one: f"self.{one}(t)" for ours in self.functions.values() for one in ours[:-1]}

    def read(self, name, expression, allowed=1, further=()):
        """The user's expression in the model's symbols. allowed: the highest derivative of q that it may have; further: symbols of ours
        that it may have. Raises InputError.
        """
        if any(not isinstance(one.expr, AppliedUndef) for one in expression.atoms(sp.Derivative)):
            expression = expression.doit()
        found = expression.xreplace(self._replaced)
        symbols = found.free_symbols
        if reason := self._objection(found, symbols - set(further), allowed):
            raise self.error(name, expression, reason)
        self.used |= symbols
        return found

    def error(self, name, expression, reason):
        """Make the InputError that rejects one of the user's expressions for a reason."""
        return InputError(f"{self.part}: {name} = {short(expression)}: {reason}")

    def _objection(self, found, symbols, allowed):
        """Why an expression cannot be taken, or an empty text."""
        if unknown := sorted(found.atoms(AppliedUndef, sp.Derivative), key=str):
            return self._unknown(next((one for one in unknown if isinstance(one, sp.Derivative)), unknown[0]))
        if missing := sorted(symbols - self._known(), key=str):
            return f"{missing[0]} has no value{self._other_assumptions(missing[0])}"
        for order, group in enumerate((self.q, self.v, self.a)):
            if order > allowed and symbols & set(group):
                return f"it must have no {WORDS[order]}{'; rows with velocities are given as psi' * (allowed == 0)}"
        return ""

    def _known(self):
        """The set of all symbols that expressions of the model may contain: t, q, v, a, x, values and functions of time."""
        ours = {one for _, one, _ in self.parameters.values()} | {one for group in self.functions.values() for one in group}
        return {T, *self.q, *self.v, *self.a, *self.x} | ours

    def _unknown(self, one):
        """Why a function or derivative cannot be taken, in words for the message."""
        one = one.xreplace({ours: user for user, ours in self._replaced.items()})
        inner = one.expr if isinstance(one, sp.Derivative) else one
        if inner in self.functions or inner in self.user_q:
            return f"{one} cannot be taken; coordinates and functions of time have {MOST} derivatives, and depend on {self.user_t} alone"
        if inner in self.user_x:
            return f"{one} is the rate of a state, which states={{{inner}: rate}} gives; write the rate in its place"
        if inner.args == (self.user_t,):
            return f"{inner} is no coordinate and no state, and has no value: give it in values, as a profile or a function of time"
        return f"{inner} is a function that is not known"

    def _other_assumptions(self, symbol):
        """Advice for an unknown symbol: give a value for it, or use that of `values` with the same name and other assumptions."""
        same = any(key.name == symbol.name for key, _, _ in self.parameters.values())
        return f"; values has a symbol {symbol} with other assumptions (as positive=True)" if same else f": give values={{{symbol}: ...}}"

    def require_used(self):
        """Raise InputError for a value that no expression has."""
        for key, ours, _ in self.parameters.values():
            if ours not in self.used:
                known = ", ".join(str(other) for other, one, _ in self.parameters.values() if one in self.used)
                raise InputError(f"{self.part}: values has {key}, but no expression has it; they have {known or 'no symbols'}")
        for key, ours in self.functions.items():
            if not self.used & set(ours):
                raise InputError(f"{self.part}: values has {key}, but no expression has it")


def number_of(part, key, value):
    """The value of a symbol, a float. Raises InputError."""
    value = float(value) if isinstance(value, sp.Expr) and value.is_number and value.is_real else value
    if not is_number(value):
        kind = " (a function of time takes the place of a Function, as dynamicsymbols gives it)" * isinstance(value, Profile)
        raise InputError(f"{part}: values[{key}] = {value!r:.80} must be a finite number{kind}")
    return float(value)
