"""Models from equations of sympy: `lagrangian`, `equations` and `mechanics`. sympy is imported when they are called."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from polyida.validation import flag, library, named_keywords

if TYPE_CHECKING:
    from polyida.symbolic.model import SymbolicModel

__all__ = ["equations", "lagrangian", "mechanics"]


def __dir__():
    """Return the public names of the package, `__all__`, for `dir()`."""
    return __all__


@named_keywords
def lagrangian(
    L: Any,
    q: Sequence,
    phi: Sequence = (),
    psi: Sequence = (),
    forces: Sequence = (),
    states: Mapping | None = None,
    values: Mapping | None = None,
    compiled: bool = True,
) -> SymbolicModel:
    """Make a model from a Lagrangian of sympy: `M a + g + phi_q^T lam + W^T nu = 0` with exact derivatives.

    Parameters
    ----------
    L : expression
        Kinetic less potential energy, J, in t, the coordinates and their first derivatives, in these quadratic.
    q : list of n functions of time
        The coordinates, as `dynamicsymbols` gives them; q0 and v0 of `pi.solve` have their order.
    phi : list of m expressions
        Holonomic constraints, phi(t, q) = 0; an equation is its left side less its right one.
    psi : list of p expressions
        Velocity rows, linear in q': rolling, a blade.
    forces : list of n expressions
        Generalised forces that are no part of L, as of motors and friction.
    states : dict
        {function of time: its derivative}, first-order states x; `pi.solve` gets their start values as x0.
    values : dict
        {symbol: number}, and {function of time: profile, compiled function or number}, as of dynamicsymbols that are no coordinates.
    compiled : bool
        numba compiles the functions, as by `pi.compiled`.

    Returns
    -------
    SymbolicModel
        A `pi.Model` for all integrators and studies.

    Raises
    ------
    InputError
        For an expression that is no part of a model; the message has it.
    """
    _require_sympy("lagrangian", compiled)
    from polyida.symbolic.systems import lagrangian as make

    return make(L, q, phi, psi, forces, states, values, bool(compiled))


@named_keywords
def equations(
    M: Any,
    g: Sequence,
    q: Sequence,
    phi: Sequence = (),
    psi: Sequence = (),
    states: Mapping | None = None,
    values: Mapping | None = None,
    potential: Any = None,
    compiled: bool = True,
) -> SymbolicModel:
    """Make a model from matrices that were derived by other means.

    Parameters
    ----------
    M : (n, n) matrix of expressions
        The mass matrix, symmetric, of q alone.
    g : list of n expressions
        The forces of `M a + g + phi_q^T lam = 0`, with this sign, in t, q, q' and states.
    q, phi, psi, states, values
        As of `lagrangian`.
    potential : expression, optional
        The potential energy, J, of q alone, of all forces in g that act at rest; with it `EnergyMomentum` takes models of constant mass.
    compiled : bool
        As of `lagrangian`.

    Returns
    -------
    SymbolicModel
        A `pi.Model` for all integrators and studies.

    Raises
    ------
    InputError
        For an expression that is no part of a model; the message has it.
    """
    _require_sympy("equations", compiled)
    from polyida.symbolic.systems import equations as make

    return make(M, g, q, phi, psi, states, values, potential, bool(compiled))


@named_keywords
def mechanics(method: Any, values: Mapping | None = None, compiled: bool = True) -> SymbolicModel:
    """Make a model from a `LagrangesMethod` or `KanesMethod` of sympy.physics.mechanics, with its constraints and forces.

    Speeds u of a KanesMethod, `u = W(q) q' + w`, are put back to q'. If it has eliminated dependent speeds, the equations of all speeds are
    formed from its bodies and loads, and its constraints become rows: velocity constraints that are derivatives of its configuration
    constraints are left out.

    Parameters
    ----------
    method : LagrangesMethod, KanesMethod, JointsMethod or System
        Of a KanesMethod `kanes_equations` must have been called.
    values, compiled
        As of `lagrangian`. A value that no equation has is kept: sympy may have cancelled its symbol.

    Returns
    -------
    SymbolicModel
        A `pi.Model`; its `evaluate` knows the speeds u and sympy's multipliers.

    Raises
    ------
    InputError
        For a method that cannot be taken; the message says what to give in its place.
    """
    _require_sympy("mechanics", compiled)
    from polyida.symbolic.methods import mechanics as make

    return make(method, values, bool(compiled))


def _require_sympy(function, compiled):
    """Raise an error unless sympy can be imported, with how to install it, and unless `compiled` is a bool."""
    library("sympy", f"symbolic.{function}: it needs sympy: pip install 'polyida[symbolic]'")
    flag(f"symbolic.{function}", "compiled", compiled)
