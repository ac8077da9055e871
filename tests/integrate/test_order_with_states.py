"""Orders of places, velocities, states and multipliers of scenes with states and velocity rows, in all integrators of smooth models."""

import numpy as np
import pytest

import polyida as pi


def driven_pendulum():
    """A pendulum with a motor in its hinge, and a filtered PID controller: k = 3, m = 3."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 2.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="pin"))
    scene.add(pi.DCMotor(bar.at("left"), pi.profile.sine(6.0, 1.0), k=0.5, L=0.1, R=1.0, name="motor"))
    scene.add(pi.PID(bar.at("left"), kp=20.0, ki=30.0, kd=4.0, target=0.3, filter=0.05, name="pid"))
    return scene.build(), 1.0


def car_and_trailer():
    """A car that is steered, and a trailer, both on skates; a spring and damper in series pulls the car: k = 3, m = 4, p = 2."""
    scene = pi.Scene()
    start = {"mass": 2.0, "inertia": 0.5, "velocity": (1.0, 0.0)}
    car = scene.add(pi.RigidBody(points={"axle": (-0.3, 0.0), "front": (0.3, 0.0), "hitch": (-0.5, 0.0)}, name="car", **start))
    trailer = scene.add(pi.RigidBody(points={"axle": (-0.2, 0.0), "hitch": (0.5, 0.0)}, origin=(-1.0, 0.0), name="trailer", **start))
    scene.add(pi.Revolute(car.at("hitch"), trailer.at("hitch"), name="hitch"))
    scene.add(pi.Skate(car.at("axle"), name="rear wheel"))
    scene.add(pi.Skate(trailer.at("axle"), name="wheel of the trailer"))
    scene.add(pi.Maxwell(pi.ground.at((3.0, 2.0)), car.at("front"), stiffness=5.0, damping=2.0, name="rope"))
    scene.add(pi.PID(car.at("axle"), kp=8.0, ki=4.0, kd=2.0, target=pi.profile.sine(0.6, 0.7), filter=0.1, name="driver"))
    return scene.build(), 1.5


def motion(run):
    """Places, velocities, states and multipliers of all frames."""
    at = np.setdiff1d(np.arange(run.model.n), run.model.hidden)
    return run.q[:, at], run.v[:, at], run.x, run.lam


def errors(run, exact):
    """Largest errors of q, v, x and lam at the end of a run."""
    return np.array([np.abs(one[-1] - other[-1]).max() for one, other in zip(motion(run), exact)])


@pytest.fixture(scope="module", params=[driven_pendulum, car_and_trailer], ids=lambda make: make.__name__)
def problem(request):
    model, end = request.param()
    return model, end, motion(pi.solve(model, end, pi.RadauIIA(h=end / 160, tolerance=1e-13)))


ORDERS = {  # steps of the coarse run, least and largest orders of q, v, x and lam
    "alpha": (lambda h: pi.GeneralizedAlpha(h=h, tolerance=1e-13), 100, (1.85,) * 4, 2.15),
    "alpha stabilised": (lambda h: pi.GeneralizedAlpha(h=h, form="stabilised", tolerance=1e-13), 100, (1.85,) * 4, 2.15),
    "Radau": (lambda h: pi.RadauIIA(h=h, tolerance=1e-14), 20, (4.95, 4.95, 4.9, 4.9), np.inf),
    "energy": (lambda h: pi.EnergyMomentum(h=h, tolerance=1e-13), 100, (1.85,) * 4, 2.15),
}


@pytest.mark.parametrize("name", ORDERS)
def test_orders(problem, name):
    (model, end, exact), (make, steps, least, most) = problem, ORDERS[name]
    coarse, fine = (errors(pi.solve(model, end, make(end / n)), exact) for n in (steps, 2 * steps))
    orders = np.log2(coarse / fine)
    assert (orders >= least).all() and (orders <= most).all(), orders


def test_errors_of_ida_follow_its_tolerance(problem):
    model, end, exact = problem
    rtols, every = 10.0 ** -np.arange(5.0, 9.1, 0.5), []  # many: the error of one is up to three times that of the next
    for rtol in rtols:  # at the ends of runs: between steps the interpolation of lam is linear
        runs = {k: pi.solve(model, end * k / 160, pi.IDA(rtol=rtol)) for k in range(40, 161, 40)}
        every.append(np.max([errors(run, [values[: k + 1] for values in exact]) for k, run in runs.items()], axis=0))
    slopes = np.polyfit(np.log10(rtols), np.log10(every), 1)[0]
    assert (slopes >= 0.8).all(), slopes
