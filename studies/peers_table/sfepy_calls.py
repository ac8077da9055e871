"""Checks of SfePy."""

import tempfile
from pathlib import Path

import numpy as np

from peers_table.rows import NotThere, only, require


def block(dimension=3):
    """(problem, variables u and v, material, integrals, mesh) of a hyperelastic block of 1 m."""
    from sfepy.base.base import output
    from sfepy.discrete import Equation, Equations, FieldVariable, Integral, Integrals, Material, Problem
    from sfepy.discrete.fem import FEDomain, Field
    from sfepy.mesh.mesh_generators import gen_block_mesh
    from sfepy.terms import Term

    output.set_output(quiet=True)
    mesh = gen_block_mesh([1.0] * dimension, [3] * dimension, [0.0] * dimension, name="block", verbose=False)
    whole = FEDomain("domain", mesh).create_region("Omega", "all")
    field = Field.from_args("displacement", np.float64, "vector", whole, approx_order=1)
    u, v = FieldVariable("u", "unknown", field), FieldVariable("v", "test", field, primary_var_name="u")
    material, integral = Material("m", mu=20.0), Integral("i", order=2)
    term = Term.new("dw_tl_he_neohook(m.mu, v, u)", integral, whole, m=material, v=v, u=u)
    problem = Problem("block", equations=Equations([Equation("balance", term)]))
    problem.time_update()
    return problem, u, v, material, Integrals([integral]), mesh


def forces(setup, moved):
    """Largest nodal force of the block under a displacement."""
    problem, u, v, material, integrals, mesh = setup
    u.set_data(moved.ravel())
    wanted = {"mode": "weak", "dw_mode": "vector", "integrals": integrals, "m": material, "u": u, "v": v, "verbose": False}
    return float(np.abs(problem.evaluate("dw_tl_he_neohook.i.Omega(m.mu, v, u)", **wanted)).max())


def turned():
    """A hyperelastic block turned by 1 rad about z has no force; stretched it has."""
    setup = block()
    turn = np.array([[np.cos(1), -np.sin(1), 0], [np.sin(1), np.cos(1), 0], [0, 0, 1]])
    x = setup[-1].coors
    still, stretched = forces(setup, x @ turn.T - x), forces(setup, x * [0.1, 0.0, 0.0])
    require(still < 1e-10 * stretched, f"turned {still:.1e} N, stretched {stretched:.1e} N")
    return f"a block turned by 1 rad has {still:.0e} N at its nodes, one stretched by a tenth {stretched:.1f} N"


def polygon():
    """A pentagon as a mesh of one cell."""
    from sfepy.discrete.fem import FEDomain, Mesh

    corners = np.array([[np.cos(a), np.sin(a)] for a in 2 * np.pi * np.arange(5) / 5])
    try:
        FEDomain("domain", Mesh.from_data("pentagon", corners, None, [np.arange(5)[None]], [np.zeros(1, int)], ["2_5"]))
    except (KeyError, ValueError) as error:
        raise NotThere(f"a cell of kind 2_5: {type(error).__name__} {error}") from None
    return "a mesh of one pentagon"


def elastodynamics(scheme):
    """(problem, displacements, status) of the package's own example of elastodynamics with a scheme of time, in the plane."""
    import sfepy
    from sfepy.base.base import IndexedStruct, output
    from sfepy.base.conf import ProblemConf, get_standard_keywords
    from sfepy.discrete import Problem

    output.set_output(quiet=True)
    path = Path(sfepy.__file__).parent / "examples" / "linear_elasticity" / "elastodynamic.py"
    with tempfile.TemporaryDirectory() as folder:
        options = {"dims": (1e-2, 2.5e-3), "shape": (11, 4), "save_times": 2, "ct1": 1.0, "output_dir": folder}
        configuration = ProblemConf.from_file(str(path), *get_standard_keywords(), define_args=options)
        next(one for one in configuration.solvers.values() if one.name == "tsn").kind = scheme
        problem, status = Problem.from_conf(configuration), IndexedStruct()
        problem.setup_output(output_dir=folder)
        state = problem.solve(save_results=False, status=status)
    return problem, state.get_state_parts()["u"], status


def alpha():
    """The scheme against Newmark's on the same block that hits a wall."""
    other, result = (elastodynamics(f"ts.{name}")[1] for name in ("newmark", "generalized_alpha"))
    away = float(np.abs(result - other).max() / np.abs(other).max())
    require(away < 0.1, f"{away:.1e} from Newmark's")
    return f"generalized-alpha and Newmark's method are {away:.0e} of the displacement apart on a block that hits a wall"


def schemes():
    from sfepy.solvers import solver_table

    return [name for name in solver_table if name.startswith("ts.")]


def own_scheme():
    """A user-defined class, registered by its name, takes the steps of the example."""
    from sfepy.solvers import register_solver
    from sfepy.solvers.ts_solvers import NewmarkTS

    class Counted(NewmarkTS):
        name, steps = "ts.counted", 0

        def step(self, *args, **kwargs):
            Counted.steps += 1
            return super().step(*args, **kwargs)

    register_solver(Counted)
    elastodynamics("ts.counted")
    require(Counted.steps > 0, "it was not used")
    return f"a class of a user took {Counted.steps} steps"


def matrix():
    """The matrix of the last step."""
    result = elastodynamics("ts.newmark")[0].mtx_a
    require(result is not None and result.nnz, "no matrix")
    return f"its matrix, {result.shape[0]} by {result.shape[1]}, with {result.nnz} entries, for scipy to look at"


def counts():
    status = elastodynamics("ts.newmark")[2].to_dict()
    result = {key: value for key, value in status.items() if isinstance(value, (int, float))} | dict(status.get("nls_status", {}).to_dict())
    require(bool(result), "no count")
    return f"status: {', '.join(f'{key} {value}' for key, value in result.items() if isinstance(value, (int, float)))}"


def restarted():
    """A state is written to a restart file and read back."""
    problem, u, *_, mesh = block()
    moved = 0.1 * mesh.coors
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "state.h5")
        u.set_data(moved.ravel())
        problem.save_restart(path)
        again = block()
        again[0].load_restart(path)
        away = float(np.abs(again[1]().reshape(moved.shape) - moved).max())
    require(away == 0.0, f"{away}")
    return "a state came back from its restart file"


CHECKS = {
    "bodies in three dimensions": turned,
    "polygonal elements": polygon,
    "plates or solids under large rotation": turned,
    "generalized-alpha on index 3": alpha,
    "BDF of variable order": lambda: only(schemes(), ["bdf"]),
    "Radau IIA": lambda: only(schemes(), ["radau"]),
    "energy-momentum": lambda: only(schemes(), ["energy"]),
    "an integrator of one's own": own_scheme,
    "condition number of the iteration matrix": matrix,
    "counts of the work": counts,
    "a run that was killed goes on": restarted,
}
