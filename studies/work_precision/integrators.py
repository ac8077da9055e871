"""All integrators and forms with the names that the studies use, and their cost at an error."""

import numpy as np

from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.energy.energy_momentum import EnergyMomentum
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.radau.radau_iia import RadauIIA

FIXED = {  # name: integrator of a step h and further settings of generalized-alpha
    "alpha": lambda h, settings: GeneralizedAlpha(h=h, **settings),
    "alpha, rho 0.99": lambda h, settings: GeneralizedAlpha(h=h, rho_inf=0.99, **settings),
    "alpha, rho 0.5": lambda h, settings: GeneralizedAlpha(h=h, rho_inf=0.5, **settings),
    "alpha, stabilised": lambda h, settings: GeneralizedAlpha(h=h, form="stabilised", **settings),
    "alpha, Richardson": lambda h, settings: GeneralizedAlpha(h=h, extrapolate=True, tolerance=1e-11),
    "HHT": lambda h, settings: GeneralizedAlpha.hht(h, **settings),
    "Newmark": lambda h, settings: GeneralizedAlpha.newmark(h, **settings),
    "energy-momentum": lambda h, settings: EnergyMomentum(h=h),
}
RADAU = {  # name: settings of Radau IIA beside its step h
    "radau, fixed": {},
    "radau, 2 stages": {"stages": 2},
    "radau, index3": {"form": "index3"},
    "radau, index3, v as it is": {"form": "index3", "project": False},
}
IDA_FORMS = ("ggl2", "ggl1", "index2", "index1", "baumgarte", "index3")
MAX_STEPS = {"index3": 2000}  # raw index 3 takes tens of thousands of tiny steps and fails


def by_tolerance(name):
    """True if an integrator's x is a tolerance, rather than a step."""
    return name in ("alpha, adaptive", "radau") or name.startswith("IDA ")


def ida(form, rtol, max_num_steps=200_000):
    """IDA in a form with its default absolute tolerances and at most `max_num_steps` steps."""
    return IDA(rtol=rtol, form=form, max_num_steps=MAX_STEPS.get(form, max_num_steps))


def adaptive(rtol, h, sizes=(1e-2, 10.0), **settings):
    """Generalized-alpha with error control of q and steps of at most h."""
    return GeneralizedAlpha(h=h, rtol=rtol, atol=rtol * sizes[0], **settings)


def integrator(name, x, sizes=(1e-2, 10.0), largest=0.1, newton=None):
    """The integrator called `name` with step or tolerance x; InputError for an unknown name.

    sizes: of q and v, for the absolute tolerance of adaptive generalized-alpha. largest: step of one that adapts it.
    newton: tolerance of generalized-alpha's iteration, None: its own default.
    """
    settings = {} if newton is None else {"tolerance": newton}
    if name in FIXED:
        return FIXED[name](x, settings)
    if name in RADAU:
        return RadauIIA(h=x, **RADAU[name])
    if name == "radau":
        return RadauIIA(rtol=x)
    if name == "alpha, adaptive":
        return adaptive(x, largest, sizes, **settings)
    if name.startswith("IDA ") and name[4:] in IDA_FORMS:
        return ida(name[4:], x)
    known = [*FIXED, "alpha, adaptive", "radau", *RADAU, *(f"IDA {form}" for form in IDA_FORMS)]
    raise InputError(f"integrator {name!r} is unknown; there are {'; '.join(known)}")


def cheapest(rows, error, level):
    """CPU seconds at which the lower envelope of runs reaches an error, interpolated on logarithmic axes; NaN if no run does."""
    pairs = sorted((row["cpu_s"], row[error]) for row in rows if np.isfinite(row.get(error) or np.nan) and row[error] > 0)
    before = None
    for cpu, result in pairs:
        if result <= level:
            if before is None:
                return cpu
            weight = np.log(before[1] / level) / np.log(before[1] / result)
            return float(np.exp((1 - weight) * np.log(before[0]) + weight * np.log(cpu)))
        if before is None or result < before[1]:
            before = (cpu, result)
    return float("nan")
