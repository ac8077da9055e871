"""Scenes of rigid bodies and pins in exudyn, with its own bodies and joints."""

import time
import warnings

import numpy as np

from polyida import Revolute
from polyida.body.rigid_body import RigidBody

SETTINGS = [(solver, newton) for solver in ("sparse", "dense") for newton in ("modified", "full")]
SPARSE = SETTINGS[:2]


class Bodies:
    """The rigid bodies and revolute joints of a Scene as a system of exudyn. Raises ImportError if it is not installed."""

    def __init__(self, scene):
        import exudyn
        import exudyn.itemInterface as items

        self.exu, self.container = exudyn, exudyn.SystemContainer()
        with warnings.catch_warnings(action="ignore"):  # newer versions have other names as well
            self.system = add = self.container.AddSystem()
            self.numbers, self.frames = {}, {}
            ground = add.AddObject(items.ObjectGround())
            for body in (part for part in scene.parts.values() if isinstance(part, RigidBody)):
                place = complex(*body.origin) + np.exp(1j * body.angle) * complex(*body.center)
                pose, rates = [place.real, place.imag, body.angle], [*body.velocity, body.spin]
                node = add.AddNode(items.NodeRigidBody2D(referenceCoordinates=pose, initialVelocities=rates))
                number = add.AddObject(items.ObjectRigidBody2D(physicsMass=body.mass, physicsInertia=body.inertia, nodeNumber=node))
                marker = add.AddMarker(items.MarkerBodyMass(bodyNumber=number))
                add.AddLoad(items.LoadMassProportional(markerNumber=marker, loadVector=[*scene.gravity, 0.0]))
                self.numbers[id(body)], self.frames[id(body)] = number, (place, np.exp(-1j * body.angle))
            for joint in (part for part in scene.parts.values() if isinstance(part, Revolute)):
                sides = []
                for side in (joint.a, joint.b):
                    place, turn = self.frames.get(id(side.body), (0.0, 1.0))
                    local = turn * (complex(*side.point) - place)
                    number = self.numbers.get(id(side.body), ground)
                    at = items.MarkerBodyPosition(bodyNumber=number, localPosition=[local.real, local.imag, 0.0])
                    sides.append(add.AddMarker(at))
                add.AddObject(items.ObjectJointRevolute2D(markerNumbers=sides))
            add.Assemble()

    def run(self, h, steps, setting):
        """(CPU s, place of the last body's centre, m) of generalized-alpha, rho_inf 0.9."""
        exu, s = self.exu, self.exu.SimulationSettings()
        with warnings.catch_warnings(action="ignore"):
            s.timeIntegration.numberOfSteps, s.timeIntegration.endTime = steps, steps * h
            s.timeIntegration.generalizedAlpha.spectralRadius = 0.9
            s.timeIntegration.newton.useModifiedNewton = setting[1] == "modified"
            s.timeIntegration.verboseMode, s.parallel.numberOfThreads = 0, 1
            s.solutionSettings.writeSolutionToFile, s.solutionSettings.sensorsWritePeriod = False, 1e9
            s.linearSolverType = exu.LinearSolverType.EigenSparse if setting[0] == "sparse" else exu.LinearSolverType.EXUdense
            begin = time.process_time()
            if not self.system.SolveDynamic(s):
                raise RuntimeError("exudyn did not converge")
            seconds = time.process_time() - begin
            number = list(self.numbers.values())[-1]
            place = self.system.GetObjectOutputBody(number, exu.OutputVariableType.Position, [0.0, 0.0, 0.0])
        return seconds, np.array(place[:2])
