"""St. Venant-Kirchhoff material of a plate."""

from dataclasses import dataclass

from polyida.errors import InputError
from polyida.given import is_number, is_one_of, settle
from polyida.keywords import named_keywords

NUMBERS = ("E", "nu", "rho", "viscosity", "mass_damping")


@named_keywords
@dataclass(frozen=True)
class Material:
    """St. Venant-Kirchhoff, `S = E/(1 - nu^2) [(1 - nu) E_GL + nu tr(E_GL) I]` in plane stress.

    E: Young's modulus, Pa, > 0. nu: Poisson's ratio in (-1, 0.5). rho: density, kg/m3, > 0. plane: "stress" or
    "strain"; plane strain is the same formula with E/(1 - nu^2) and nu/(1 - nu).

    viscosity: Kelvin-Voigt time, s, >= 0: `S = D : (E_GL + viscosity E_GL')`. It is Rayleigh's stiffness-proportional
    part about the state at rest, where a mode of frequency w rad/s has the damping ratio `viscosity w / 2`; it is
    objective, so rigid motion, however fast, dissipates nothing. The stabilisation of virtual elements is not damped
    by it: what their cells' constant F does not see swings on freely.
    mass_damping: Rayleigh's mass-proportional part, 1/s, >= 0: a force `mass_damping M v` with the plate's M (point
    masses are not damped), the damping ratio `mass_damping / (2 w)`. It acts on the velocity itself, as a medium at
    rest would: rigid motion is braked too, a free plate slows down as `exp(-mass_damping t)` and falls at `g /
    mass_damping` at most.

    All numbers are kept as floats. Raises InputError naming the value that is out of range.
    """

    E: float
    nu: float
    rho: float
    plane: str = "stress"
    viscosity: float = 0.0
    mass_damping: float = 0.0

    def __post_init__(self):
        for name, value, good, want in (
            ("E", self.E, is_number(self.E) and self.E > 0, "a positive modulus in Pa"),
            ("nu", self.nu, is_number(self.nu) and -1 < self.nu < 0.5, "inside (-1, 0.5)"),
            ("rho", self.rho, is_number(self.rho) and self.rho > 0, "a positive density in kg/m3"),
            ("viscosity", self.viscosity, is_number(self.viscosity) and self.viscosity >= 0, "a time in s, not negative"),
            ("mass_damping", self.mass_damping, is_number(self.mass_damping) and self.mass_damping >= 0, "a rate in 1/s, not negative"),
            ("plane", self.plane, is_one_of(self.plane, ("stress", "strain")), '"stress" or "strain"'),
        ):
            if not good:
                raise InputError(f"Material: {name} = {value!r} must be {want}")
        settle(self, **{name: float(getattr(self, name)) for name in NUMBERS})

    @property
    def damped(self) -> bool:
        """Whether the material brakes motion."""
        return self.viscosity > 0 or self.mass_damping > 0

    @property
    def in_plane(self) -> tuple[float, float]:
        """(modulus, ratio) that the plane-stress formula takes for this material."""
        if self.plane == "stress":
            return self.E, self.nu
        return self.E / (1 - self.nu**2), self.nu / (1 - self.nu)

    @property
    def across(self) -> float:
        """Ratio of the stress across the plane to xx + yy: Hooke's nu in plane strain, which is St. Venant-Kirchhoff's at small strains."""
        return self.nu if self.plane == "strain" else 0.0
