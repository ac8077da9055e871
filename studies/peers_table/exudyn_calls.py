"""Checks of exudyn."""

import tempfile
from pathlib import Path

import numpy as np

from peers_table.rows import GRAVITY, T_END, only, require, swung

H = 1e-3


def scene():
    """(exudyn, an empty system)."""
    import exudyn

    return exudyn, exudyn.SystemContainer().AddSystem()


def settings(exudyn, h=H, t_end=T_END):
    """Settings of a quiet run that writes nothing."""
    options = exudyn.SimulationSettings()
    options.timeIntegration.numberOfSteps, options.timeIntegration.endTime = round(t_end / h), t_end
    options.timeIntegration.verboseMode = options.staticSolver.verboseMode = 0
    options.timeIntegration.generalizedAlpha.spectralRadius = 0.9
    options.solutionSettings.writeSolutionToFile = False
    return options


def pendulum(axis=1):
    """(exudyn, system, number of the mass): a point mass on a rod of 1 m, weight along an axis."""
    exudyn, system = scene()
    weight = -GRAVITY * np.eye(3)[axis]
    ground = system.CreateGround()
    mass = system.CreateMassPoint(referencePosition=[1.0, 0.0, 0.0], physicsMass=1.0, gravity=weight.tolist())
    system.CreateDistanceConstraint(bodyNumbers=[ground, mass], distance=1.0)
    system.Assemble()
    return exudyn, system, mass


def position(exudyn, system, body):
    """Current position of a body, (3,)."""
    return np.array(system.GetObjectOutputBody(body, exudyn.OutputVariableType.Position, localPosition=[0.0, 0.0, 0.0]))


def spatial():
    """The pendulum swings in the plane of x and z."""
    exudyn, system, mass = pendulum(axis=2)
    system.SolveDynamic(settings(exudyn))
    return swung(position(exudyn, system, mass)[[0, 2]], 1e-4)


def index_3():
    exudyn, system, mass = pendulum()
    system.SolveDynamic(settings(exudyn), solverType=exudyn.DynamicSolverType.GeneralizedAlpha)
    return swung(position(exudyn, system, mass), 1e-4)


def cable():
    """A clamped cable of 1 m under the end moment that bends it to a half circle."""
    exudyn, system = scene()
    from exudyn.beams import GenerateStraightLineANCFCable2D
    from exudyn.itemInterface import Cable2D, MarkerNodeRigid, Torque

    template = Cable2D(physicsMassPerLength=1.0, physicsBendingStiffness=1.0, physicsAxialStiffness=1e4)
    nodes = GenerateStraightLineANCFCable2D(
        system, [0, 0, 0], [1, 0, 0], numberOfElements=16, cableTemplate=template, fixedConstraintsNode0=[1, 1, 0, 1]
    )[0]
    marker = system.AddMarker(MarkerNodeRigid(nodeNumber=nodes[-1]))
    system.AddLoad(Torque(markerNumber=marker, loadVector=[0, 0, np.pi]))
    system.Assemble()
    options = settings(exudyn)
    options.staticSolver.numberOfLoadSteps = 20
    system.SolveStatic(options)
    end = np.array(system.GetNodeOutput(nodes[-1], exudyn.OutputVariableType.Position))[:2]
    away = float(np.linalg.norm(end - [0.0, 2 / np.pi]))
    require(away < 1e-2, f"its end is {away:.1e} m from that of a half circle")
    return f"a cable bent to a half circle ends {away:.1e} m from where it should"


def joints():
    """A block falls along a prismatic joint; a wheel on a revolute joint is turned by a stiff damper of a given speed."""
    exudyn, system = scene()
    from exudyn.utilities import InertiaCuboid

    ground, inertia = system.CreateGround(), InertiaCuboid(density=1000.0, sideLengths=[0.1, 0.1, 0.1])
    block = system.CreateRigidBody(referencePosition=[3, 0, 0], inertia=inertia, gravity=[0, -GRAVITY, 0])
    system.CreatePrismaticJoint(bodyNumbers=[ground, block], position=[3, 0, 0], axis=[0, 1, 0])
    wheel = system.CreateRigidBody(referencePosition=[5, 0, 0], inertia=inertia)
    system.CreateRevoluteJoint(bodyNumbers=[ground, wheel], position=[5, 0, 0], axis=[0, 0, 1])
    system.CreateTorsionalSpringDamper(
        bodyNumbers=[ground, wheel], position=[5, 0, 0], axis=[0, 0, 1], stiffness=0.0, damping=1e4, velocityOffset=2.0
    )
    system.Assemble()
    system.SolveDynamic(settings(exudyn))
    fallen = position(exudyn, system, block)[1] + GRAVITY * T_END**2 / 2
    require(abs(fallen) < 1e-4, f"the sliding body is {fallen:.1e} m off")
    turned = system.GetObjectOutputBody(wheel, exudyn.OutputVariableType.Rotation, localPosition=[0, 0, 0])[2]
    require(abs(turned - 2 * T_END) < 0.05, f"the wheel has turned by {turned:.2f}")
    return f"a body slides, a wheel turned by {turned:.3f} rad of {2 * T_END:g}"


def own_model():
    """Force and constraint by user functions."""
    exudyn, system = scene()
    import exudyn.itemInterface as items

    node = system.AddNode(
        items.NodeGenericODE2(
            referenceCoordinates=[0.0, 0.0], initialCoordinates=[0.0, 0.0], initialCoordinates_t=[0.0, 0.0], numberOfODE2Coordinates=2
        )
    )
    system.AddObject(
        items.ObjectGenericODE2(nodeNumbers=[node], massMatrix=np.eye(2), forceUserFunction=lambda mbs, t, item, q, v: [0.0, -GRAVITY])
    )
    ground = system.AddNode(items.NodePointGround())
    markers = [system.AddMarker(items.MarkerNodeCoordinates(nodeNumber=number)) for number in (ground, node)]
    place = np.array([1.0, 0.0])
    system.AddObject(
        items.ObjectConnectorCoordinateVector(
            markerNumbers=markers,
            scalingMarker0=np.zeros((1, 1)),
            constraintUserFunction=lambda mbs, t, item, q, v, velocity: (
                [2 * (place + q) @ v] if velocity else [(place + q) @ (place + q) - 1.0]
            ),
            jacobianUserFunction=lambda mbs, t, item, q, v, velocity: 2 * (place + q)[None],
        )
    )
    system.Assemble()
    system.SolveDynamic(settings(exudyn))
    return swung(place + system.systemData.GetODE2Coordinates(), 1e-4)


def solvers():
    """The names of exudyn's dynamic solvers."""
    import exudyn

    return list(exudyn.DynamicSolverType.__members__)


def own_step():
    """A step in Python in place of the solver's Newton iteration: Verlet, for a mass on a spring."""
    exudyn, system, mass, omega = oscillator()
    solver = exudyn.MainSolverImplicitSecondOrder()

    def step(solver, system, options):
        h, data = solver.it.currentStepSize, system.systemData
        q, v = data.GetODE2Coordinates(), data.GetODE2Coordinates_t()
        half = v + h / 2 * acceleration(solver, system)
        data.SetODE2Coordinates(q + h * half)
        data.SetODE2Coordinates_t(half + h / 2 * acceleration(solver, system))
        return True

    solver.SetUserFunctionNewton(system, step)
    require(solver.SolveSystem(system, settings(exudyn)), "no end")
    away = abs(system.systemData.GetODE2Coordinates()[0] - GRAVITY / omega**2 * (1 - np.cos(omega * T_END)))
    require(away < 1e-5, f"the mass is {away:.1e} m off")
    return f"a step of Verlet in Python: a mass on a spring ends {away:.1e} m from where it should"


def acceleration(solver, system):
    """Acceleration of an unconstrained system in its current state."""
    solver.ComputeMassMatrix(system)
    solver.ComputeODE2RHS(system)
    return np.linalg.solve(solver.GetSystemMassMatrix(), solver.GetSystemResidual())


def oscillator():
    """(exudyn, system, number of the mass, omega): 2 kg on springs of 200 N/m, under weight along x."""
    exudyn, system = scene()
    ground = system.CreateGround()
    mass = system.CreateMassPoint(referencePosition=[0.0, 0.0, 0.0], physicsMass=2.0, gravity=[GRAVITY, 0.0, 0.0])
    system.CreateCartesianSpringDamper(bodyNumbers=[ground, mass], stiffness=[200.0] * 3, damping=[0.0] * 3)
    system.Assemble()
    return exudyn, system, mass, 10.0


def after_a_run():
    """(solver, system) after a run of the implicit solver."""
    exudyn, system, mass = pendulum()
    solver = exudyn.MainSolverImplicitSecondOrder()
    require(solver.SolveSystem(system, settings(exudyn)), "no end")
    return solver, system


def condition():
    solver, system = after_a_run()
    matrix = np.array(solver.GetSystemJacobian())
    return f"its iteration matrix, {matrix.shape[0]} by {matrix.shape[1]}, has by numpy the condition number {np.linalg.cond(matrix):.2g}"


def counts():
    solver, system = after_a_run()
    result = solver.it.newtonStepsCount, solver.it.newtonJacobiCount
    require(min(result) > 0, f"counts {result}")
    return f"Newton steps {result[0]}, Jacobians {result[1]}"


def linear():
    """A mass on springs: its rest, its frequency, its matrices."""
    exudyn, system, mass, omega = oscillator()
    system.SolveStatic(settings(exudyn))
    moved = position(exudyn, system, mass)[0]
    square = float(np.real(system.ComputeODE2Eigenvalues()[0]).min())
    M, K, D = (np.array(matrix) for matrix in system.ComputeLinearizedSystem()[:3])
    require(np.isclose(moved, GRAVITY / omega**2) and np.isclose(square, omega**2), f"rest at {moved}, omega^2 = {square}")
    require(np.allclose(np.linalg.solve(M, K), omega**2 * np.eye(3)), f"M = {M}, K = {K}")
    return f"a mass on springs rests at {moved:.4f} m, omega^2 = {square:.4g}, M, K, D of the linearised system"


def swung_by(row):
    """Height of the pendulum's end, m, of a run with the step in a dictionary."""
    exudyn, system, mass = pendulum()
    system.SolveDynamic(settings(exudyn, h=row["h"]))
    return float(position(exudyn, system, mass)[1])


def varied():
    """Three runs with three steps, by its own function for variations."""
    from exudyn.processing import ParameterVariation

    steps, heights = ParameterVariation(swung_by, {"h": [1e-2, 5e-3, 1e-3]}, showProgress=False)
    require(len(heights) == 3 and np.ptp(heights) < 1e-3, f"{heights}")
    return f"{len(heights)} runs, ends within {np.ptp(heights):.1e} m"


def restarted():
    """A run of half the time writes its restart file; the same system, made anew, goes on from it to the end."""
    with tempfile.TemporaryDirectory() as folder:
        for t_end in (T_END / 2, T_END):
            exudyn, system, mass = pendulum()
            options = settings(exudyn, t_end=t_end)
            restart = options.solution.restart
            restart.write = restart.continueIfAvailable = True
            restart.name, restart.writePeriod = str(Path(folder) / "state.txt"), 0.05
            solver = exudyn.MainSolverImplicitSecondOrder()
            require(solver.SolveSystem(system, options), "no end")
        require(solver.output.restartTime > 0, "it began anew")
        return f"went on from t = {solver.output.restartTime:g} s; {swung(position(exudyn, system, mass), 1e-4)}"


def bodies():
    """Names of exudyn's objects."""
    import exudyn.itemInterface as items

    return [name for name in dir(items) if name.startswith("Object") and "UserFunction" not in name]


CHECKS = {
    "bodies in three dimensions": spatial,
    "polygonal elements": lambda: only(bodies(), ["polygon"]),
    "rods or shells under large rotation": cable,
    "revolute, prismatic, motor": joints,
    "a model of one's own": own_model,
    "generalized-alpha on index 3": index_3,
    "BDF of variable order": lambda: only(solvers(), ["BDF"]),
    "Radau IIA": lambda: only(solvers(), ["Radau"]),
    "energy-momentum": lambda: only(solvers(), ["Energy"]),
    "an integrator of one's own": own_step,
    "condition number of the iteration matrix": condition,
    "counts of the work": counts,
    "statics, modes, linearisation": linear,
    "many runs beside each other": varied,
    "a run that was killed goes on": restarted,
}
