"""Checks of Kratos, with its StructuralMechanics and LinearSolvers applications."""

import tempfile
from pathlib import Path

import numpy as np

from peers_table.rows import only, require

OMEGA, STEPS = 10.0, 500  # of 2 kg on a spring of 200 N/m, and steps of 1 ms


def modules():
    """(Kratos, its StructuralMechanicsApplication), which only warn."""
    import KratosMultiphysics as kratos
    import KratosMultiphysics.StructuralMechanicsApplication as structural

    kratos.Logger.GetDefaultOutput().SetSeverity(kratos.Logger.Severity.WARNING)
    return kratos, structural


def part(kratos, dimension=2):
    """(the model, a model part of it) with displacements, velocities and accelerations."""
    model = kratos.Model()
    part_of_model = model.CreateModelPart("part", 6)
    part_of_model.ProcessInfo[kratos.DOMAIN_SIZE] = dimension
    for name in ("DISPLACEMENT", "REACTION", "VELOCITY", "ACCELERATION", "VOLUME_ACCELERATION"):
        part_of_model.AddNodalSolutionStepVariable(getattr(kratos, name))
    return model, part_of_model


def free(kratos, part_of_model):
    """Degrees of freedom of all nodes."""
    for axis in "XYZ":
        kratos.VariableUtils().AddDof(getattr(kratos, f"DISPLACEMENT_{axis}"), getattr(kratos, f"REACTION_{axis}"), part_of_model)


def turned(element, points, law):
    """Largest internal force, N, of an element turned by 1 rad about z, over its largest stiffness times its largest displacement."""
    kratos, structural = modules()
    model, part_of_model = part(kratos, len(points[0]))
    for k, point in enumerate(points):
        part_of_model.CreateNewNode(k + 1, *point, *[0.0] * (3 - len(point)))
    properties = part_of_model.CreateNewProperties(1)
    for name, value in {"YOUNG_MODULUS": 1e6, "POISSON_RATIO": 0.3, "DENSITY": 1e3, "THICKNESS": 1.0}.items():
        properties[getattr(kratos, name)] = value
    properties[kratos.CONSTITUTIVE_LAW] = getattr(structural, law)()
    free(kratos, part_of_model)
    part_of_model.CreateNewElement(element, 1, [node.Id for node in part_of_model.Nodes], properties)
    one, matrix, force = part_of_model.GetElement(1), kratos.Matrix(), kratos.Vector()
    one.Initialize(part_of_model.ProcessInfo)
    turn, largest = np.array([[np.cos(1), -np.sin(1), 0], [np.sin(1), np.cos(1), 0], [0, 0, 1]]), 0.0
    for node in part_of_model.Nodes:
        start = np.array([node.X0, node.Y0, node.Z0])
        moved = turn @ start - start
        node.SetSolutionStepValue(kratos.DISPLACEMENT, kratos.Array3(moved.tolist()))
        node.X, node.Y, node.Z = start + moved
        largest = max(largest, float(np.abs(moved).max()))
    one.CalculateLocalSystem(matrix, force, part_of_model.ProcessInfo)
    return float(np.abs(np.array(force)).max() / np.abs(np.array(matrix)).max() / largest)


def rigid(element, *properties):
    share = turned(element, *properties)
    require(share < 1e-10, f"{element}, turned by 1 rad, pushes back: {share:.1e}")
    return f"{element}, turned by 1 rad, has a force of {share:.0e} of its stiffness"


SQUARE = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
CUBE = tuple((*point, z) for z in (0.0, 1.0) for point in SQUARE)


def geometries():
    kratos, structural = modules()
    return list(kratos.GeometryData.KratosGeometryType.__members__)


def oscillator():
    """(Kratos, its structural part, model, part): 2 kg on a spring of 200 N/m, drawn out by 1 m."""
    kratos, structural = modules()
    model, part_of_model = part(kratos, 3)
    node = part_of_model.CreateNewNode(1, 0.0, 0.0, 0.0)
    free(kratos, part_of_model)
    part_of_model.CreateNewElement("NodalConcentratedElement3D1N", 1, [1], part_of_model.CreateNewProperties(1))
    element = part_of_model.GetElement(1)
    element.SetValue(kratos.NODAL_MASS, 2.0)
    element.SetValue(structural.NODAL_DISPLACEMENT_STIFFNESS, kratos.Array3([200.0] * 3))
    element.Initialize(part_of_model.ProcessInfo)
    for t in np.arange(-5, 1) * 1e-3:  # what a scheme of several steps looks back at
        part_of_model.CloneTimeStep(t)
        node.SetSolutionStepValue(kratos.DISPLACEMENT_X, np.cos(OMEGA * t))
        node.SetSolutionStepValue(kratos.VELOCITY_X, -OMEGA * np.sin(OMEGA * t))
        node.SetSolutionStepValue(kratos.ACCELERATION_X, -(OMEGA**2) * np.cos(OMEGA * t))
    return kratos, structural, model, part_of_model


def strategy(kratos, part_of_model, scheme):
    """Newton's method with a scheme of time."""
    solver, criterion = kratos.SkylineLUFactorizationSolver(), kratos.ResidualCriteria(1e-10, 1e-12)
    builder = kratos.ResidualBasedBlockBuilderAndSolver(solver)
    result = kratos.ResidualBasedNewtonRaphsonStrategy(part_of_model, scheme, criterion, builder, 10, False, False, False)
    result.SetEchoLevel(0)
    criterion.SetEchoLevel(0)
    result.Initialize()
    return result


def vibrated(scheme, bound):
    """(distance of the mass from the exact position after half a second, m; strategy)."""
    kratos, structural, model, part_of_model = oscillator()
    newton = strategy(kratos, part_of_model, scheme(kratos))
    for _ in range(STEPS):
        part_of_model.CloneTimeStep(part_of_model.ProcessInfo[kratos.TIME] + 1e-3)
        part_of_model.ProcessInfo[kratos.STEP] += 1
        newton.Solve()
    end = part_of_model.GetNode(1).GetSolutionStepValue(kratos.DISPLACEMENT_X)
    away = abs(end - np.cos(OMEGA * STEPS * 1e-3))
    require(away < bound, f"the mass is {away:.1e} m off")
    return away, newton, kratos, part_of_model


def bossak_scheme(kratos):
    return kratos.ResidualBasedBossakDisplacementScheme(-0.1)


def bossak():
    away = vibrated(bossak_scheme, 1e-2)[0]
    return f"Bossak's member of generalized-alpha: a mass on a spring ends {away:.1e} m from where it should"


def bdf():
    away = {order: vibrated(lambda kratos, order=order: kratos.ResidualBasedBDFDisplacementScheme(order), 1e-2)[0] for order in (2, 5)}
    return f"BDF of a fixed order: a mass on a spring ends {away[2]:.1e} m off with order 2, {away[5]:.1e} m with order 5"


def schemes():
    kratos, structural = modules()
    return [name for module in (kratos, structural) for name in dir(module) if name.endswith("Scheme")]


def condition():
    away, newton, kratos, part_of_model = vibrated(bossak_scheme, 1e-2)
    import KratosMultiphysics.LinearSolversApplication  # noqa: F401, it brings the solvers of eigenvalues

    matrix = newton.GetSystemMatrix()
    from KratosMultiphysics.eigen_solver_factory import ConstructSolver

    rest = '"max_iteration": 1000, "tolerance": 1e-9, "linear_solver_settings": {"solver_type": "skyline_lu_factorization"}'
    largest, smallest = (
        ConstructSolver(kratos.Parameters(f'{{"solver_type": "{kind}", {rest}}}'))
        for kind in ("power_iteration_highest_eigenvalue_solver", "power_iteration_eigenvalue_solver")
    )
    number = kratos.ConditionNumberUtility().GetConditionNumber(matrix, largest, smallest)
    require(number >= 0.99, f"condition number {number}")
    return f"of the scheme's matrix, {matrix.Size1()} by {matrix.Size2()}: {number:.2g}"


def counts():
    away, newton, kratos, part_of_model = vibrated(bossak_scheme, 1e-2)
    result = part_of_model.ProcessInfo[kratos.NL_ITERATION_NUMBER]
    require(result > 0, "no count")
    return f"Newton iterations of the last step: {result}"


def modes():
    """The frequency of the mass on its spring."""
    kratos, structural, model, part_of_model = oscillator()
    import KratosMultiphysics.LinearSolversApplication as linear

    solver = linear.EigensystemSolver(
        kratos.Parameters('{"solver_type": "eigen_eigensystem", "number_of_eigenvalues": 1, "tolerance": 1e-9}')
    )
    builder = kratos.ResidualBasedBlockBuilderAndSolver(solver)
    result = structural.EigensolverStrategy(part_of_model, structural.EigensolverDynamicScheme(), builder, 1.0, 0.0, False)
    result.Initialize()
    result.Solve()
    square = float(part_of_model.ProcessInfo[structural.EIGENVALUE_VECTOR][0])
    require(np.isclose(square, OMEGA**2), f"omega^2 = {square}")
    return f"omega^2 = {square:.4g} of a mass on a spring"


def restarted():
    """A model part is written by the restart utility and read into a new model."""
    kratos, structural, model, part_of_model = oscillator()
    from KratosMultiphysics.restart_utility import RestartUtility

    with tempfile.TemporaryDirectory() as folder:
        place = f'"input_filename": "state", "input_output_path": "{Path(folder).as_posix()}", "restart_load_file_label": "0.0"'
        properties = kratos.Parameters(f"{{{place}}}")
        RestartUtility(part_of_model, properties).SaveRestart()
        again = kratos.Model().CreateModelPart("part", 6)
        RestartUtility(again, properties).LoadRestart()
        moved = again.GetNode(1).GetSolutionStepValue(kratos.DISPLACEMENT_X)
    require(moved == 1.0, f"{moved}")
    return "a model part came back from its restart file, with its displacements"


CHECKS = {
    "bodies in three dimensions": lambda: rigid("TotalLagrangianElement3D8N", CUBE, "LinearElastic3DLaw"),
    "polygonal elements": lambda: only(geometries(), ["polygon", "polyhed"]),
    "plates or solids under large rotation": lambda: rigid("TotalLagrangianElement2D4N", SQUARE, "LinearElasticPlaneStress2DLaw"),
    "generalized-alpha on index 3": bossak,
    "BDF of variable order": bdf,
    "Radau IIA": lambda: only(schemes(), ["radau"]),
    "energy-momentum": lambda: only(schemes(), ["energymomentum", "energyconserv"]),
    "condition number of the iteration matrix": condition,
    "counts of the work": counts,
    "statics, modes, linearisation": modes,
    "a run that was killed goes on": restarted,
}
