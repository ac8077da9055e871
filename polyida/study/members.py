"""All integrators and forms under the names that studies call them by."""

from polyida.errors import InputError
from polyida.integrate.energy_momentum import EnergyMomentum
from polyida.integrate.generalized_alpha import GeneralizedAlpha
from polyida.integrate.ida import IDA

FIXED = {  # name: integrator of a step h and Newton's tolerance
    "alpha": lambda h, newton: GeneralizedAlpha(h=h, tolerance=newton),
    "alpha, rho 0.99": lambda h, newton: GeneralizedAlpha(h=h, rho_inf=0.99, tolerance=newton),
    "alpha, rho 0.5": lambda h, newton: GeneralizedAlpha(h=h, rho_inf=0.5, tolerance=newton),
    "alpha, stabilised": lambda h, newton: GeneralizedAlpha(h=h, form="stabilised", tolerance=newton),
    "alpha, Richardson": lambda h, newton: GeneralizedAlpha(h=h, extrapolate=True, tolerance=1e-11),
    "HHT": lambda h, newton: GeneralizedAlpha.hht(h, tolerance=newton),
    "Newmark": lambda h, newton: GeneralizedAlpha.newmark(h, tolerance=newton),
    "energy-momentum": lambda h, newton: EnergyMomentum(h=h),
}
NEWTON = 1e-4  # of beta h^2 |a|, the integrator's own default
IDA_FORMS = ("ggl2", "ggl1", "index2", "index1", "baumgarte", "index3")
MAX_STEPS = {"index3": 2000}  # raw index 3 takes tens of thousands of tiny steps and fails


def ida(form, rtol, max_num_steps=200_000):
    """IDA in a form, its absolute tolerances its own; no more steps than `max_num_steps`."""
    return IDA(rtol=rtol, form=form, max_num_steps=MAX_STEPS.get(form, max_num_steps))


def adaptive(tolerance, h, sizes=(1e-2, 10.0), newton=NEWTON):
    """Generalized-alpha with error control of q, no step above h."""
    return GeneralizedAlpha(h=h, rtol=tolerance, atol=tolerance * sizes[0], tolerance=newton)


def integrator(name, x, sizes=(1e-2, 10.0), largest=0.1, newton=NEWTON):
    """The integrator called `name` with step or tolerance x; InputError for an unknown name.

    sizes: of q and v, for the absolute tolerance of adaptive generalized-alpha. largest: step of one that adapts it. newton: tolerance of
    generalized-alpha's iteration.
    """
    if name in FIXED:
        return FIXED[name](x, newton)
    if name == "alpha, adaptive":
        return adaptive(x, largest, sizes, newton)
    if name.startswith("IDA ") and name[4:] in IDA_FORMS:
        return ida(name[4:], x)
    known = [*FIXED, "alpha, adaptive", *(f"IDA {form}" for form in IDA_FORMS)]
    raise InputError(f"integrator {name!r} is unknown; there are {'; '.join(known)}")
