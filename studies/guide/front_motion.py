"""The moving picture of the README and of the guide: `python studies/guide/front_motion.py` computes and draws it, in a few seconds."""

from pathlib import Path

import numpy as np

import polyida as pi
from polyida.show import plates
from polyida.show.moving_svg import moving_svg

PLACE = Path(__file__).with_name("motion.svg")
TURN, FRAMES = 0.5, 36  # s of one turn of the crank; frames of a turn
CRANK, ROD = 0.12, 0.4


def scene():
    """A slider crank with a soft rod: a motor turns the crank, a spring and a damper hold the slider."""
    made = pi.Scene(gravity=(0.0, -9.81))
    soft = pi.Material(E=40e6, nu=0.4, rho=1100.0, viscosity=3e-3)
    angle = -np.arcsin(CRANK / ROD)
    end = (ROD * np.cos(angle), 0.0)
    crank = made.add(pi.RigidBody.bar(CRANK, 0.3, angle=np.pi / 2, name="crank"))
    plate = pi.Plate(pi.mesh.rectangle(ROD, 0.024, cells=40, seed=1), soft, 0.02, origin=(0.0, CRANK), angle=angle, name="rod")
    rod = made.add(pi.Reduced(plate, modes=6))
    slider = made.add(pi.RigidBody(0.2, 1e-3, {"pin": (0.0, 0.0)}, origin=end, name="slider"))
    made.add(pi.Revolute(pi.ground, crank.at("left"), name="bearing"))
    made.add(pi.Revolute(crank.at("right"), rod.section("left"), name="crank pin"))
    made.add(pi.Revolute(rod.section("right"), slider.at("pin"), name="wrist pin"))
    made.add(pi.Prismatic(pi.ground.at((0.0, 0.0)), slider.at("pin"), name="guide"))
    made.add(pi.SpringDamper(pi.ground.at((0.75, 0.0)), slider.at("pin"), stiffness=20.0, damping=1.0, name="spring"))
    made.add(pi.AngleMotor(pi.ground, crank.at("left"), turns, name="motor"))
    return made


def turns(t):
    """The angle of the crank, rad."""
    return 2 * np.pi * t / TURN


def main():
    made = scene()
    made.assemble()
    run = pi.solve(made.build(), 6 * TURN, pi.GeneralizedAlpha(h=5e-4))
    last = np.linspace(5 * TURN, 6 * TURN, FRAMES + 1)  # the first turns have the vibrations of the start
    PLACE.write_text(moving_svg(run, plates.frames_at(run, last), seconds=2.0), encoding="utf-8")
    print(f"{PLACE}: {PLACE.stat().st_size / 1e3:.0f} kB, {run.summary()}")


if __name__ == "__main__":
    main()
