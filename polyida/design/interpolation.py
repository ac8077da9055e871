"""What a density makes of stiffness and mass, and how it is driven to 0 and 1: functions of rho with their slopes."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.given import floats, is_number
from polyida.keywords import named_keywords


@named_keywords
def ramp(rho: ArrayLike, q: float = 20.0, void: float = 1e-3) -> tuple[NDArray, NDArray]:
    """(stiffness, its slope in rho) by RAMP: `void + (1 - void) rho / (1 + q (1 - rho))`; what has no density is `void` times as stiff.

    Its slope at rho = 0 is not zero: with `mass(rho)` in proportion, thin regions keep a stiffness in proportion to their mass and
    have no slow vibrations of their own. Raises InputError for densities outside [0, 1], q < 0 and void outside (0, 1).
    Source: Stolpe, Svanberg, Struct. Multidisc. Optim. 22 (2001).
    """
    rho, void = _densities("ramp", rho), _part("ramp", "void", void)
    if not (is_number(q) and q >= 0):
        raise InputError(f"ramp: q = {q!r} must be a number of at least 0")
    below = 1.0 + q * (1.0 - rho)
    return void + (1.0 - void) * rho / below, (1.0 - void) * (1.0 + q) / below**2


@named_keywords
def simp(rho: ArrayLike, p: float = 3.0, void: float = 1e-3) -> tuple[NDArray, NDArray]:
    """(stiffness, its slope in rho) by SIMP: `void + (1 - void) rho^p`; what has no density is `void` times as stiff.

    In motion it wants `mass(rho, low=0.1)`: with mass in proportion, thin regions have slow vibrations of their own. Raises InputError for
    densities outside [0, 1], p < 1 and void outside (0, 1). Source: Bendsoe, Sigmund, Arch. Appl. Mech. 69 (1999), in the modified form.
    """
    rho, void = _densities("simp", rho), _part("simp", "void", void)
    if not (is_number(p) and p >= 1):
        raise InputError(f"simp: p = {p!r} must be a number of at least 1")
    return void + (1.0 - void) * rho**p, (1.0 - void) * p * rho ** (p - 1.0)


@named_keywords
def mass(rho: ArrayLike, low: float = 0.0, void: float = 1e-3) -> tuple[NDArray, NDArray]:
    """(mass, its slope in rho): `void + (1 - void) m(rho)` with m = rho, and below `low` with `m = 6 rho^6 / low^5 - 5 rho^7 / low^6`.

    The polynomial goes on from rho with its value and slope and falls as rho^6, faster than the stiffness of SIMP. Raises InputError for
    densities outside [0, 1], low outside [0, 1) and void outside (0, 1).
    Source of the polynomial: Du, Olhoff, Struct. Multidisc. Optim. 34 (2007).
    """
    rho, void = _densities("mass", rho), _part("mass", "void", void)
    if not (is_number(low) and 0 <= low < 1):
        raise InputError(f"mass: low = {low!r} must be at least 0 and below 1")
    part = np.where(rho < low, rho / (low or 1.0), 1.0)
    value = np.where(rho < low, low * (6.0 - 5.0 * part) * part**6, rho)
    return void + (1.0 - void) * value, (1.0 - void) * (36.0 - 35.0 * part) * part**5


@named_keywords
def project(rho: ArrayLike, beta: float, eta: float = 0.5) -> tuple[NDArray, NDArray]:
    """(projected density, its slope in rho): `(tanh(beta eta) + tanh(beta (rho - eta))) / (tanh(beta eta) + tanh(beta (1 - eta)))`.

    0 and 1 stay; the larger beta, the nearer is all above eta to 1 and all below to 0. Raises InputError for densities outside [0, 1], a
    beta that is not positive and eta outside (0, 1). Source: Wang, Lazarov, Sigmund, Struct. Multidisc. Optim. 43 (2011).
    """
    rho, eta = _densities("project", rho), _part("project", "eta", eta)
    if not (is_number(beta) and beta > 0):
        raise InputError(f"project: beta = {beta!r} must be a positive number")
    shifted, low = np.tanh(beta * (rho - eta)), np.tanh(beta * eta)
    span = low + np.tanh(beta * (1.0 - eta))
    return (low + shifted) / span, beta * (1.0 - shifted**2) / span


def _densities(what, rho, round_off=1e-9):
    """rho as an array held to [0, 1], which a filter may leave by round-off."""
    given = floats(rho)
    if given is None or (np.abs(given - 0.5) > 0.5 + round_off).any():
        shown = repr(rho)[:80] if given is None else f"{given.min():.6g} to {given.max():.6g}"
        raise InputError(f"{what}: densities rho are {shown}; they must be numbers from 0 to 1")
    return np.clip(given, 0.0, 1.0)


def _part(what, name, value):
    if not (is_number(value) and 0 < value < 1):
        raise InputError(f"{what}: {name} = {value!r} must be between 0 and 1")
    return float(value)
