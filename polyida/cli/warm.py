"""`polyida warm`: short runs that compile the kernels of all integrators and parts, on all cores; and what is compiled, for `polyida info`."""

import multiprocessing
import os
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed

import polyida as pi
from polyida.environment import cores
from polyida.errors import InputError

SHORT = 4e-3  # s: length of the runs
TURN = pi.profile.quintic(0.0, 0.2, duration=0.5)


def plates(order=1, contact=False, friction=0.0, bodies=lambda plate: plate, **material):
    """Two rubber plates with a pin, a motor, a spring and a damper, in contact with the ground or not. friction: of the pin; bodies: makes the body of a plate."""
    scene, rubber = pi.Scene(gravity=(0.0, -9.81)), pi.Material(E=50e6, nu=0.3, rho=1100.0, **material)
    mesh = pi.mesh.rectangle(1.0, 0.1, cells=12, seed=1)
    upper = scene.add(bodies(pi.Plate(mesh, rubber, 0.01, order=order, name="upper")))
    lower = scene.add(bodies(pi.Plate(mesh, rubber, 0.01, order=order, origin=(1.0, 0.0), name="lower")))
    pin = {"friction": friction, "pin_radius": 0.01} if friction else {}
    scene.add(pi.Revolute(pi.ground, upper.section("left"), name="shoulder", **pin))
    scene.add(pi.Revolute(upper.section("right"), lower.section("left"), name="elbow"))
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), TURN, name="motor"))
    scene.add(pi.SpringDamper(pi.ground.at((2.0, -1.0)), lower.section("right"), stiffness=10.0, damping=0.1, name="spring"))
    if contact:
        scene.add(pi.Contact(pi.ground.at((0.0, -0.1), direction=(1.0, 0.0)), lower.section("right"), friction=0.3, name="floor"))
    return scene.build()


def _run(model, integrator, q0=None):
    """Run a model for SHORT seconds with an integrator, from q0 or the model's own start."""
    return pi.solve(model, SHORT, integrator, q0=q0)


def _small(integrator):
    """Run the pendulum for SHORT seconds with an integrator: the kernels of small dense models."""
    _run(pi.problems.get("pendulum").model, integrator, [-1.0, 0.0])


def _gradient(integrator):
    """Differentiate the peak stress of a short run with respect to a Young's modulus: the kernels of adjoints."""
    pi.gradient(_run(plates(viscosity=1e-4), integrator), pi.objective.PeakStress(), ["upper.E"])


def _rest():
    """Compute an equilibrium of the plates and its modes, to compile those kernels."""
    model = plates()
    pi.modes(model, pi.static(model))


WORK = {  # those first that have little in common
    "generalized-alpha": lambda: _run(plates(viscosity=1e-4), pi.GeneralizedAlpha(h=1e-3)),
    "small models": lambda: [_small(one) for one in (pi.GeneralizedAlpha(h=1e-3), pi.RadauIIA(), pi.EnergyMomentum(h=1e-3), pi.IDA())],
    "Radau IIA": lambda: _run(plates(viscosity=1e-4), pi.RadauIIA()),
    "IDA": lambda: _run(plates(viscosity=1e-4), pi.IDA()),
    "energy-momentum": lambda: _run(plates(), pi.EnergyMomentum(h=1e-3)),
    "time stepping": lambda: [_run(plates(contact=True), one) for one in (pi.NonsmoothAlpha(h=1e-3), pi.MoreauJean(h=1e-3))],
    "viscoelastic plates": lambda: [
        _run(plates(prony=((0.5, 0.01),)), one) for one in (pi.GeneralizedAlpha(h=1e-3), pi.RadauIIA(), pi.IDA())
    ],
    "quadratic cells": lambda: [_run(plates(order=2), one) for one in (pi.GeneralizedAlpha(h=1e-3), pi.RadauIIA())],
    "reduced and rigid bodies": lambda: [
        _run(plates(bodies=bodies), one)
        for bodies in (pi.Rigid, lambda plate: pi.Reduced(plate, modes=2))
        for one in (pi.GeneralizedAlpha(h=1e-3), pi.RadauIIA(), pi.IDA(), pi.EnergyMomentum(h=1e-3))
    ],
    "other forms": lambda: [
        _run(plates(), one) for one in (pi.GeneralizedAlpha(h=1e-3, form="stabilised"), pi.RadauIIA(form="index3"), pi.RadauIIA(stages=2))
    ],
    "friction": lambda: [_run(plates(friction=0.1), one) for one in (pi.GeneralizedAlpha(h=1e-3), pi.RadauIIA(), pi.IDA())],
    "gradients": lambda: _gradient(pi.GeneralizedAlpha(h=1e-3)),
    "gradients of Radau IIA": lambda: _gradient(pi.RadauIIA(h=1e-3)),
    "equilibria and modes": _rest,
}


def _kept_in():
    """The folder in which compiled kernels are stored, or None."""
    from polyida.jit import cache  # here, because a file that imports it at its head counts as one that makes kernels

    return cache.folder()


def compiled():
    """{"folder": of the kernels or None, "kernels": number, "own": number of users' functions, "mb": size, "of": {folder of the package: number}}."""
    folder = _kept_in()
    files = list(folder.rglob("*.nbc")) if folder else []
    kernels = [file for file in files if not file.name.startswith("user_functions.")]
    of, own = Counter(file.parent.name.rpartition("_")[0] for file in kernels), len(files) - len(kernels)
    size = sum(file.stat().st_size for file in files) / 1e6
    return {"folder": folder and str(folder), "kernels": len(kernels), "own": own, "mb": round(size, 1), "of": dict(sorted(of.items()))}


def compiled_text(found):
    """What `compiled` found, as a text of one line."""
    if not found["folder"]:
        return "in no folder, because none can be written: each process compiles anew; set NUMBA_CACHE_DIR"
    of = ", ".join(f"{name} {count}" for name, count in found["of"].items())
    own = f" and {found['own']} functions of users" if found["own"] else ""
    return f"{found['kernels']} kernels{own}, {found['mb']:g} MB, in {found['folder']}" + (f" ({of})" if of else "")


def _work(name):
    """Call the function WORK[name], which makes short runs so that kernels are compiled, in this process and with warnings hidden."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        WORK[name]()


def warm(progress=lambda done, total, name: None):
    """Compile all kernels in a process for each core. Raises InputError if no folder can keep them."""
    if _kept_in() is None:
        raise InputError("warm: no folder can keep the kernels; set NUMBA_CACHE_DIR to one that can be written")
    os.environ["POLYIDA_QUIET"] = "1"  # of the processes
    progress(0, len(WORK), "")
    with ProcessPoolExecutor(min(cores(), len(WORK)), multiprocessing.get_context("spawn")) as pool:
        waiting = {pool.submit(_work, name): name for name in WORK}
        for done, future in enumerate(as_completed(waiting), 1):
            future.result()
            progress(done, len(WORK), waiting[future])
    return compiled()
