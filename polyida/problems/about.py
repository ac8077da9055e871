"""What each problem compares, with units, and where its reference comes from: one line, details after a semicolon."""

COMPUTED = (
    "computed by DOP853 on the index-1 equations, rtol 1e-11; Radau IIA, rtol 1e-13, agrees to 3e-12 .. 5e-12 m, 5e-10 m/s, 6e-4 N "
    "(python studies/digits.py)"
)
TIP = '"tip" in m, its velocity in m/s, lam in N and N m, at t = 1 s; largest absolute error'
AT_POINT = '"{}" in m, its velocity in m/s, at t = {} s; largest absolute error'
MECHANISM = "computed by DOP853 on the index-1 equations, rtol 1e-8 to 1e-12; Radau IIA, rtol 1e-12, agrees to 4e-12 m, 3e-9 m/s (python studies/digits.py)"

ABOUT = {
    "pendulum": {
        "quantity": "q in m, v in m/s, lam in N, at t = 10 s; largest absolute error",
        "source": "IFToMM library of benchmark problems, A01; elliptic closed form, v and lam from the energy",
    },
    "car-axis": {
        "quantity": "q in m, v in m/s, lam in N/m, at t = 3 s; largest absolute error",
        "source": "IVP test set, car axis problem (PSIDE)",
    },
    "andrews": {
        "quantity": "q in rad, v in rad/s, a in rad/s2, lam in N, at t = 0.03 s; largest absolute error",
        "source": "computed by DOP853 on the index-1 equations, rtol 2.3e-14; Radau IIA, rtol 1e-13, agrees to 2.5e-12 rad, the printed "
        "digits of the IVP test set, Andrews' squeezing mechanism (PSIDE), to 1.4e-9 rad (python studies/digits.py andrews)",
    },
    "andrews-parts": {
        "quantity": "angles in rad, their rates in rad/s, at t = 0.03 s; largest absolute error",
        "source": "the digits of andrews, computed from its equations in minimal angles; those that are printed are 1.4e-9 rad away",
    },
    "double-plate": {"quantity": TIP.replace(" and N m", ""), "source": COMPUTED},
    "double-plate-motors": {"quantity": TIP, "source": COMPUTED},
    "plate-chain": {"quantity": TIP.replace(" and N m", ""), "source": COMPUTED},
    "spin-up-beam": {
        "quantity": "steady extension of the tip in m; mean over t >= 16 s",
        "source": "Simo, Vu-Quoc, J. Appl. Mech. 53 (1986) 849; rho A w^2 L^3 / (3 EA) of the steadily turning bar",
    },
    "rigid-limit": {
        "quantity": "nodal q in m, v in m/s, joint forces lam in N, at t_end; largest absolute error",
        "source": "equation of two rigid bodies by DOP853; the flexible plates come near as 1 / E",
    },
    "rigid-pendulum": {"quantity": AT_POINT.format("tip", "1"), "source": "equation of two rigid bodies by DOP853, rtol 1e-13"},
    "n-four-bar": {
        "quantity": AT_POINT.format("B0", "0.7").replace("at t = 0.7 s", "at t_end"),
        "source": "IFToMM library of benchmark problems, A02; equation of its one angle by DOP853, rtol 1e-13",
    },
    "slider-crank": {"quantity": AT_POINT.format("slider", "0.4"), "source": MECHANISM},
    "four-bar": {"quantity": AT_POINT.format("pin", "0.5"), "source": MECHANISM},
    "two-link-arm": {"quantity": AT_POINT.format("tip", "0.5"), "source": MECHANISM},
    "peaucellier": {"quantity": AT_POINT.format("pen", "0.5"), "source": MECHANISM},
}
