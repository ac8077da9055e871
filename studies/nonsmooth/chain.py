"""A chain of 20 bars falls on rough ground: NonsmoothAlpha, and the penalty contact of exudyn with stiffnesses that allow less and less penetration."""

from time import process_time

import numpy as np

import polyida as pi
from nonsmooth.scenes import FLOOR, G

LINKS, LINK, MASS, MU, HEIGHT, END = 20, 0.1, 0.1, 0.3, 0.2, 2.0  # m, kg, m, s
RADIUS = 0.02  # m, of exudyn's spheres, whose floor lies lower by it
TILT = 0.3  # rad, of the chain at the start


def places():
    """Ends of the bars at the start, (LINKS + 1, 2), m."""
    along = np.arange(LINKS + 1) * LINK
    return np.stack([along * np.cos(TILT), HEIGHT + along * np.sin(TILT)], axis=1)


def ours(h):
    """The run of NonsmoothAlpha."""
    scene, bars = pi.Scene(gravity=(0.0, -G)), []
    for k, place in enumerate(places()[:-1]):
        bars.append(scene.add(pi.RigidBody.bar(LINK, MASS, place, TILT, name=f"bar {k}")))
        scene.add(pi.Contact(bars[-1].at("left"), FLOOR, friction=MU, name=f"floor {k}"))
    for k, (bar, other) in enumerate(zip(bars, bars[1:])):
        scene.add(pi.Revolute(bar.at("right"), other.at("left"), name=f"pin {k}"))
    scene.add(pi.Contact(bars[-1].at("right"), FLOOR, friction=MU, name=f"floor {LINKS}"))
    model = scene.build()
    pi.solve(model, 2 * h, pi.NonsmoothAlpha(h=h))
    begin = process_time()
    run = pi.solve(model, END, pi.NonsmoothAlpha(h=h))
    cpu = process_time() - begin
    ends = [run.position(bar.at("left")) for bar in bars] + [run.position(bars[-1].at("right"))]
    lowest = min(float(end[:, 1].min()) for end in ends)
    end = np.mean([end[-1] for end in ends], axis=0)
    done = "done" if run.success else run.message
    return {"cpu_s": cpu, "steps": run.counts.steps, "penetration": max(-lowest, 0.0), "place": end[0], "height": end[1], "outcome": done}


def of_exudyn(h, stiffness):
    """The run of exudyn's generalized-alpha with spheres at the joints against two triangles. Raises ImportError if it is not installed."""
    import exudyn
    import exudyn.itemInterface as items

    container = exudyn.SystemContainer()
    system = container.AddSystem()
    contact = system.AddGeneralContact()
    contact.verboseMode, contact.frictionProportionalZone = 0, 1e-3
    contact.SetFrictionPairings(np.array([[MU]]))
    contact.SetSearchTreeCellSize(numberOfCells=[40, 4, 1])
    contact.SetSearchTreeBox(pMin=np.array([-3.0, -1.0, -1.0]), pMax=np.array([5.0, 3.0, 1.0]))
    ground, ends, markers, last = system.AddObject(items.ObjectGround()), places(), [], None
    damping = 2.0 * np.sqrt(stiffness * MASS)  # of a critically damped link
    for k in range(LINKS):
        middle = (ends[k] + ends[k + 1]) / 2
        node = system.AddNode(items.NodeRigidBody2D(referenceCoordinates=[*middle, TILT]))
        body = system.AddObject(items.ObjectRigidBody2D(physicsMass=MASS, physicsInertia=MASS * LINK**2 / 12, nodeNumber=node))
        middle_marker = system.AddMarker(items.MarkerBodyMass(bodyNumber=body))
        system.AddLoad(items.LoadMassProportional(markerNumber=middle_marker, loadVector=[0.0, -G, 0.0]))
        at = lambda x, body=body: system.AddMarker(items.MarkerBodyRigid(bodyNumber=body, localPosition=[x, 0.0, 0.0]))  # noqa: E731
        left, right = at(-LINK / 2), at(LINK / 2)
        if last is not None:
            system.AddObject(items.ObjectJointRevolute2D(markerNumbers=[last, left]))
        markers += [left] if k < LINKS - 1 else [left, right]
        last = right
    friction = {"contactStiffness": stiffness, "contactDamping": damping, "frictionMaterialIndex": 0}
    for marker in markers:
        contact.AddSphereWithMarker(marker, radius=RADIUS, **friction)
    wide = [[-3.0, -RADIUS, -1.0], [5.0, -RADIUS, -1.0], [5.0, -RADIUS, 1.0], [-3.0, -RADIUS, 1.0]]
    floor = system.AddMarker(items.MarkerBodyRigid(bodyNumber=ground))
    contact.AddTrianglesRigidBodyBased(rigidBodyMarkerIndex=floor, pointList=wide, triangleList=[[0, 2, 1], [0, 3, 2]], **friction)
    sensors = [
        system.AddSensor(items.SensorMarker(markerNumber=m, outputVariableType=exudyn.OutputVariableType.Position, storeInternal=True))
        for m in markers
    ]
    system.Assemble()
    options = exudyn.SimulationSettings()
    options.timeIntegration.numberOfSteps, options.timeIntegration.endTime = round(END / h), END
    options.timeIntegration.verboseMode, options.parallel.numberOfThreads = 0, 1
    options.timeIntegration.generalizedAlpha.spectralRadius = 0.8
    options.timeIntegration.newton.useModifiedNewton = True
    options.solutionSettings.writeSolutionToFile, options.solutionSettings.sensorsWritePeriod = False, 1e-3
    options.linearSolverType = exudyn.LinearSolverType.EigenSparse
    begin = process_time()
    done = system.SolveDynamic(options)
    cpu = process_time() - begin
    paths = np.array([system.GetSensorStoredData(sensor)[:, 1:3] for sensor in sensors])
    place = paths[:, -1].mean(axis=0)
    row = {"cpu_s": cpu, "steps": round(END / h), "penetration": float(max(-paths[:, :, 1].min(), 0.0))}
    return row | {"place": place[0], "height": place[1], "outcome": "done" if done else "exudyn did not converge"}


def tasks(quick):
    """Ours with three steps, exudyn's with stiffnesses and the steps that they need."""
    steps = (4e-3,) if quick else (4e-3, 2e-3, 1e-3, 5e-4)
    pairs = ((1e4, 1e-3),) if quick else ((1e4, 1e-3), (1e5, 2e-4), (1e6, 1e-4), (1e7, 4e-5), (1e8, 1e-5))
    own = [{"part": "chain", "integrator": "nonsmooth alpha", "x": h, "stiffness": None} for h in steps]
    return own + [{"part": "chain", "integrator": "exudyn", "x": h, "stiffness": k} for k, h in pairs]


def measure(integrator, x, stiffness):
    """CPU seconds, deepest penetration, m, and the mean place of the joints at the end."""
    if integrator != "exudyn":
        return ours(x)
    try:
        return of_exudyn(x, stiffness)
    except ImportError:
        return {"outcome": "exudyn is not installed (extra peers)"}
