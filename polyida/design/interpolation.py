"""From densities to factors of stiffness and mass: RAMP, SIMP, projection. Each function of rho returns its value and its derivative."""

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.validation import floats, is_number, named_keywords


@named_keywords
def ramp(rho: "ArrayLike", q: float = 20.0, void: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Return the stiffness of the RAMP interpolation, `void + (1 - void) rho / (1 + q (1 - rho))`, and its derivative.

    The derivative at rho = 0 is not zero: with `mass(rho)` in proportion, regions of low density have no slow vibrations of their own.

    Parameters
    ----------
    rho : float or array, 0 to 1
    q : float, >= 0
    void : float in (0, 1)
        Relative stiffness at rho = 0.

    Returns
    -------
    (stiffness, derivative) : arrays like rho, no unit
        The relative stiffness and its derivative with respect to rho.

    Raises
    ------
    InputError
        If a value is out of range.

    Notes
    -----
    Rational approximation of material properties: Stolpe, Svanberg, Struct. Multidisc. Optim. 22 (2001).
    """
    rho, void = _densities("ramp", rho), _fraction("ramp", "void", void)
    if not (is_number(q) and q >= 0):
        raise InputError(f"ramp: q = {q!r} must be a number of at least 0")
    below = 1.0 + q * (1.0 - rho)
    return void + (1.0 - void) * rho / below, (1.0 - void) * (1.0 + q) / below**2


@named_keywords
def simp(rho: "ArrayLike", p: float = 3.0, void: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Return the stiffness of the SIMP interpolation, `void + (1 - void) rho^p`, and its derivative.

    For dynamics use `mass(rho, low=0.1)`: with mass in proportion, regions of low density have slow vibrations of their own.

    Parameters
    ----------
    rho : float or array, 0 to 1
    p : float, >= 1
    void : float in (0, 1)
        Relative stiffness at rho = 0.

    Returns
    -------
    (stiffness, derivative) : arrays like rho, no unit
        The relative stiffness and its derivative with respect to rho.

    Raises
    ------
    InputError
        If a value is out of range.

    Notes
    -----
    Bendsoe, Sigmund, Arch. Appl. Mech. 69 (1999), in the modified form.
    """
    rho, void = _densities("simp", rho), _fraction("simp", "void", void)
    if not (is_number(p) and p >= 1):
        raise InputError(f"simp: p = {p!r} must be a number of at least 1")
    return void + (1.0 - void) * rho**p, (1.0 - void) * p * rho ** (p - 1.0)


@named_keywords
def mass(rho: "ArrayLike", low: float = 0.0, void: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Return the mass `void + (1 - void) m(rho)` and its derivative: m = rho, and `6 rho^6 / low^5 - 5 rho^7 / low^6` below `low`.

    The polynomial continues rho with its value and derivative and decreases as rho^6, faster than the stiffness of SIMP.

    Parameters
    ----------
    rho : float or array, 0 to 1
    low : float in [0, 1)
    void : float in (0, 1)
        Relative mass at rho = 0.

    Returns
    -------
    (mass, derivative) : arrays like rho, no unit
        The relative mass and its derivative with respect to rho.

    Raises
    ------
    InputError
        If a value is out of range.

    Notes
    -----
    Polynomial of Du, Olhoff, Struct. Multidisc. Optim. 34 (2007).
    """
    rho, void = _densities("mass", rho), _fraction("mass", "void", void)
    if not (is_number(low) and 0 <= low < 1):
        raise InputError(f"mass: low = {low!r} must be at least 0 and below 1")
    part = np.where(rho < low, rho / (low or 1.0), 1.0)
    value = np.where(rho < low, low * (6.0 - 5.0 * part) * part**6, rho)
    return void + (1.0 - void) * value, (1.0 - void) * (36.0 - 35.0 * part) * part**5


@named_keywords
def project(rho: "ArrayLike", beta: float, eta: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Return the smoothed Heaviside projection of densities at eta, and its derivative.

    `(tanh(beta eta) + tanh(beta (rho - eta))) / (tanh(beta eta) + tanh(beta (1 - eta)))`: 0 and 1 are fixed points; a larger beta moves
    values above eta nearer to 1 and values below eta nearer to 0.

    Parameters
    ----------
    rho : float or array, 0 to 1
    beta : float, > 0
    eta : float in (0, 1)

    Returns
    -------
    (density, derivative) : arrays like rho, no unit
        The projected density and its derivative with respect to rho.

    Raises
    ------
    InputError
        If a value is out of range.

    Notes
    -----
    Wang, Lazarov, Sigmund, Struct. Multidisc. Optim. 43 (2011).
    """
    rho, eta = _densities("project", rho), _fraction("project", "eta", eta)
    if not (is_number(beta) and beta > 0):
        raise InputError(f"project: beta = {beta!r} must be a positive number")
    shifted, low = np.tanh(beta * (rho - eta)), np.tanh(beta * eta)
    span = low + np.tanh(beta * (1.0 - eta))
    return (low + shifted) / span, beta * (1.0 - shifted**2) / span


def _densities(function, rho, round_off=1e-9):
    """rho as an array clipped to [0, 1]: a filter may exceed the interval by round-off. Raises InputError if it does by more."""
    array = floats(rho)
    if array is None or (np.abs(array - 0.5) > 0.5 + round_off).any():
        shown = repr(rho)[:80] if array is None else f"{array.min():.6g} to {array.max():.6g}"
        raise InputError(f"{function}: densities rho are {shown}; they must be numbers from 0 to 1")
    return np.clip(array, 0.0, 1.0)


def _fraction(function, name, value):
    if not (is_number(value) and 0 < value < 1):
        raise InputError(f"{function}: {name} = {value!r} must be between 0 and 1")
    return float(value)
