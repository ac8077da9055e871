"""All functions of a model from its equations: their exact derivatives, and the source text of each."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import sympy as sp

from polyida.errors import InputError
from polyida.model import Needs
from polyida.symbolic.code import Unprintable, text_of_function
from polyida.symbolic.derivatives import Derivative, jacobian
from polyida.symbolic.expressions import Symbols, T, short

ROWS = {"phi": ("t", "q"), "phi_t": ("t", "q"), "phi_bias": ("t", "q", "v")}


def dot(one, other):
    """The sum of the products of two lists of expressions, entry by entry."""
    return sp.Add(*(sp.Mul(x, y) for x, y in zip(one, other)))


@dataclass(frozen=True, eq=False)
class Equations:
    """`M a + g + phi_q^T lam + W^T nu = 0`, `phi = 0`, `psi = W v + w = 0`, `x' = rates`, in the symbols of a model.

    forces: those that are no part of the potential energy; they are contained in g. potential: None if unknown. given: {name: the user's
    expression}, for messages. also: {the user's symbol: what it stands for}, of speeds and multipliers that sympy has made.
    """

    symbols: Symbols
    mass: list
    force: list
    phi: list
    psi: list
    rates: list
    forces: list
    potential: Any
    given: dict
    also: dict
    constants: dict

    @cached_property
    def lam(self):
        """Symbols lam0, lam1, ... of the multipliers, one for each row of phi and of psi."""
        return sp.symbols(f"lam:{len(self.phi) + len(self.psi)}", real=True)

    @cached_property
    def rows(self):
        """Rows of the matrix of the multipliers: phi_q, with W below it, lists of expressions."""
        return [*jacobian(self.phi, self.symbols.q), *jacobian(self.psi, self.symbols.v)]

    @cached_property
    def needs(self):
        """The Needs of the model: on what its functions depend."""
        s, flat = self.symbols, lambda rows: {one for row in rows for entry in row for one in entry.free_symbols}
        in_mass, in_rows = flat(self.mass), flat(self.rows)
        driven = any(entry != 0 for entry in self.functions_of_rows["phi_t"])
        return Needs(
            mass_varies=bool(in_mass & set(s.q)),
            velocity_forces=bool(flat([self.force]) & {*s.v, *s.x}),
            driven=driven,
            phi_q_varies=bool(in_rows & set(s.q)) or bool(self.psi),
        )

    @cached_property
    def functions_of_rows(self):
        """{name: entries} of phi, phi_t and phi_bias, also of velocity rows, whose phi is 0, phi_t w and phi_rate psi."""
        s, still = self.symbols, dict.fromkeys(self.symbols.v, sp.S.Zero)
        in_time, moving = Derivative(s.rates_of_functions()), Derivative(s.rates_of_functions() | dict(zip(s.q, s.v)))
        rates = [*map(moving, self.phi), *self.psi]
        return {
            "phi": [*self.phi, *[sp.S.Zero] * len(self.psi)],
            "phi_t": [*map(in_time, self.phi), *(psi.xreplace(still) for psi in self.psi)],
            "phi_bias": [moving(rate) for rate in rates],
        }

    def residual(self):
        """The entries of r = M a + g + phi_q^T lam, (n,), as expressions."""
        s = self.symbols
        return [
            sp.Add(dot(row, s.a), g, dot(self.lam, column))
            for row, g, column in zip(self.mass, self.force, zip(*self.rows) if self.rows else [()] * len(s.q))
        ]

    def source(self):
        """The source text of all functions. Raises InputError for what they cannot contain."""
        s, n, m = self.symbols, len(self.symbols.q), len(self.rows)
        self._require(self.mass, {T, *s.x, *s.v}, "mass", "the mass matrix", "t, states or velocities")
        behind = ("x",) * bool(s.x)
        whole = [
            ("mass", ("q",), [entry for row in self.mass for entry in row], (n, n)),
            ("force", ("t", "q", "v", *behind), self.force, (n,)),
        ]
        if not s.x:  # derivatives of forces of a model with states are differences
            whole.append(("force_q", ("t", "q", "v"), self._slopes(self.force, s.q), (n, n)))
            if self.needs.velocity_forces:
                whole.append(("force_v", ("t", "q", "v"), self._slopes(self.force, s.v), (n, n)))
        else:
            whole.append(("rates", ("t", "q", "v", "x"), self.rates, (len(s.x),)))
        if self.needs.mass_varies:
            whole.append(("mass_a_q", ("q", "a"), self._slopes([dot(row, s.a) for row in self.mass], s.q), (n, n)))
        if m:
            whole += [(name, ROWS[name], entries, (m,)) for name, entries in self.functions_of_rows.items()]
            whole.append(("phi_q", ("t", "q"), [entry for row in self.rows for entry in row], (m, n)))
            if self.needs.phi_q_varies:
                pulls = [dot(self.lam, column) for column in zip(*self.rows)]
                whole.append(("reaction_q", ("t", "q", "lam"), self._slopes(pulls, s.q), (n, n)))
        if self.potential is not None:
            whole.append(("potential", ("q",), [self.potential], ()))
        if any(self.forces):
            whole.append(("power", ("t", "q", "v", *behind), [dot(self.forces, s.v)], ()))
        return "\n\n".join(self.text(*one) for one in whole)

    def slope(self, function, name):
        """The source text of the derivative residual_p or phi_p with respect to the value `name`."""
        along = Derivative({self.symbols.parameters[name][1]: sp.S.One})
        along = Derivative({self.symbols.parameters[name][1]: sp.S.One} | {one: along(meaning) for one, meaning in self.constants.items()})
        if function == "phi_p":
            entries, arguments = [*map(along, self.functions_of_rows["phi"])], ("t", "q")
        else:
            entries, arguments = [*map(along, self.residual())], ("t", "q", "v", "a", "lam")
        return self.text(function, arguments, entries, (len(entries),))

    def text(self, name, arguments, entries, shape):
        """The source text of one function. Raises InputError for what machine code does not know."""
        names = self.symbols.names() | {one: f"lam[{k}]" for k, one in enumerate(self.lam)}
        names |= {one: f"self.constants[{k}]" for k, one in enumerate(self.constants)}
        if past := self.symbols.past() & set().union(*(entry.free_symbols for entry in entries)):
            function = next(key for key, ours in self.symbols.functions.items() if ours[-1] in past)
            raise InputError(f"{self.symbols.part}: {name} needs the third derivative of {function}, of which a profile has two")
        try:
            return text_of_function(name, arguments, entries, shape, names)
        except Unprintable as error:
            raise InputError(
                f"{self.symbols.part}: {self._where()}: {error}, so it has no machine code; write it by other functions"
            ) from None

    def _where(self):
        """The first of the user's expressions that cannot be printed, in words."""
        for name, expression in self.given.items():
            try:
                text_of_function("one", (), [self.symbols.read(name, expression, 2)], (), {})
            except Unprintable:
                return f"{name} = {short(expression)}"
        return "a derivative of an expression"

    def _slopes(self, entries, symbols):
        """The Jacobian of entries with respect to symbols as a flat list, row by row."""
        return [entry for row in jacobian(entries, symbols) for entry in row]

    def _require(self, rows, forbidden, name, what, words):
        """Raise InputError if entries of rows have forbidden symbols."""
        for i, row in enumerate(rows):
            for j, entry in enumerate(row):
                if found := entry.free_symbols & forbidden:
                    pair = " and ".join(dict.fromkeys(str(self.symbols.user_q[k]) for k in (i, j)))
                    raise InputError(
                        f"{self.symbols.part}: {what} of {pair} depends on {min(found, key=str)}, it must not have {words}: "
                        "make what moves as a function of time a coordinate s with the row phi = s - f(t)"
                    )
