"""Solvers of other packages on the models of this package: factorizations, SUNDIALS' sparse direct solver, Radau of solve_dae, exudyn.

All of them use the compiled elements of this package. Optional packages raise Missing if they are not installed.
"""

import ctypes
import math
import time
import warnings

import numpy as np

from polyida.assembly import equilibrium
from polyida.errors import InputError
from polyida.integrate.ida.forms import System
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.ida.newton import Correction
from polyida.integrate.ida.tables import FormRows
from polyida.integrate.sizes import sizes_of_run, typical_sizes
from polyida.integrate.start import consistent_state
from polyida.integrate.state import Counts

WIDEST_BAND = 40_000  # coordinates beyond which a band factor is out of the question


class Missing(InputError):
    """An optional package is not installed, or a solver does not support this case: this part of a study is omitted."""


def superlu(model, blocks):
    """(factor, solve) of SuperLU in symmetric mode with minimum degree on A + A^T; each factorization computes the ordering again."""
    from scipy.sparse.linalg import splu

    matrix, factors, b = matrix_of(model, blocks), {}, np.ones(model.n, blocks.dtype)

    def factor():
        factors["lu"] = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    return factor, lambda: factors["lu"].solve(b)


def matrix_of(model, blocks):
    """Blocks on the nodal pattern as a sparse matrix."""
    from scipy.sparse import bsr_array

    indptr, indices = model.pattern
    return bsr_array((blocks, indices, indptr), shape=(model.n, model.n)).tocsc()


def band(model, blocks):
    """(factor, solve) of LAPACK's band Cholesky in the numbering of the mesh."""
    from scipy.linalg.lapack import dpbtrf, dpbtrs
    from scipy.sparse import tril

    if model.n > WIDEST_BAND:
        raise Missing(f"no band factor beyond {WIDEST_BAND} coordinates")
    lower = tril(matrix_of(model, blocks), format="coo")
    row, column = lower.coords
    factors, b, bands = {}, np.ones(model.n), np.empty((model.n, int(np.max(row - column)) + 1))

    def factor():
        bands[:] = 0.0
        bands[column, row - column] = lower.data
        factors["factor"] = dpbtrf(bands.T, lower=1, overwrite_ab=1)[0]

    return factor, lambda: dpbtrs(factors["factor"], b, lower=1)[0]


def pardiso(model, blocks, dtype=np.float64):
    """(factor, solve) of MKL PARDISO, positive definite (mtype 2), one thread: phases 22 and 33; phase 11 is executed here."""
    try:
        from pypardiso.pardiso_wrapper import PyPardisoSolver
    except ImportError:
        raise Missing("pypardiso is not installed (extra mkl)") from None
    from scipy.sparse import triu

    solver = PyPardisoSolver(mtype=2)
    solver.libmkl.MKL_Set_Num_Threads(1)
    upper = triu(matrix_of(model, blocks), format="csr")
    upper.sort_indices()
    places = [(array + 1).astype(np.int32) for array in (upper.indptr, upper.indices)]
    arrays = [upper.data.astype(dtype), *places, solver.perm]
    b, x, error = np.ones(model.n, dtype), np.empty(model.n, dtype), ctypes.c_int32(0)
    parameters = np.zeros(64, np.int32)
    if dtype == np.float32:
        parameters[[0, 1, 27]] = 1, 2, 1  # own values, nested dissection, single precision
    kinds = solver._mkl_pardiso.argtypes

    def pointer(array, kind=ctypes.c_void_p):
        return array.ctypes.data_as(kind)

    def phase(number):
        *whole, one, quiet = [ctypes.byref(ctypes.c_int32(value)) for value in (1, 1, 2, number, model.n, 1, 0)]
        pointers = [pointer(array, kind) for array, kind in zip(arrays, kinds[6:10])]
        solver._mkl_pardiso(
            pointer(solver.pt, kinds[0]),
            *whole,
            *pointers,
            one,
            pointer(parameters, kinds[11]),
            quiet,
            pointer(b),
            pointer(x),
            ctypes.byref(error),
        )
        if error.value:
            raise RuntimeError(f"PARDISO: error {error.value} in phase {number}")
        return x

    phase(11)
    return lambda: phase(22), lambda: phase(33)


class WholeJacobian:
    """J = dF/dy + cj dF/dy' of form ggl2 on a scene with linear joints, in CSC order, for IDA.

    pattern: its sparse matrix with int32 indices. IDA calls it with (t, y, y', res, cj, JJ), and it fills JJ.
    """

    def __init__(self, model):
        from scipy.sparse import bsr_array, coo_array

        if model.needs.driven:
            raise InputError("WholeJacobian: the scene has motors; it must have linear joints alone")
        self.model, (indptr, indices), n = model, model.pattern, model.n
        self.blocks = np.empty((len(indices), 2, 2))
        numbers = np.arange(1.0, self.blocks.size + 1).reshape(self.blocks.shape)
        stiff = bsr_array((numbers, indices, indptr), shape=(n, n)).tocoo()
        self.of_block = stiff.data.astype(np.int64) - 1
        mass, jacobian, each = model.mass().tocoo(), coo_array(model.phi_q(0.0, np.zeros(n))), np.arange(n)
        self.mass, B, m = mass.data, jacobian.data, model.m
        r, c = jacobian.row, jacobian.col
        places = [
            (each, each),
            (each, n + each),
            (n + stiff.row, stiff.col),
            (n + mass.row, n + mass.col),
            (c, 2 * n + m + r),
            (n + c, 2 * n + r),
            (2 * n + r, c),
            (2 * n + m + r, n + c),
        ]
        self.fixed = -np.ones(n), np.concatenate([B, B, B, B])
        rows, columns = (np.concatenate(side) for side in zip(*places))
        numbered = coo_array((np.arange(1.0, len(rows) + 1), (rows, columns)), shape=2 * (2 * (n + m),)).tocsc()
        self.order = numbered.data.astype(np.int64) - 1
        numbered.indices, numbered.indptr = numbered.indices.astype(np.int32), numbered.indptr.astype(np.int32)
        self.pattern = numbered
        self.calls = 0

    def __call__(self, t, y, yp, res, cj, JJ):
        n = self.model.n
        equilibrium.tangent_blocks(self.model.arrays, np.array(y[:n]).reshape(-1, 2), None, 0.0, 0.0, 1.0, self.blocks)
        (minus, borders), stiffness = self.fixed, self.blocks.ravel()[self.of_block]
        JJ[:] = np.concatenate([np.full(n, cj), minus, stiffness, cj * self.mass, borders])[self.order]
        self.calls += 1


def sparse_ida(model, t_end, settings=None):
    """IDA with SuperLU_MT on the whole 2n + 2m matrix to t_end: {"cpu_s", "steps", "setups"}, start included.

    Tolerances and order of the settings; the residual of this package. It can abort the process, so call it in a separate one.
    """
    from scipy.sparse import csc_matrix
    from sksundae.ida import IDA as Solver

    settings = settings or IDA()
    system, jacobian = System(model, "ggl2", settings.baumgarte_rate), WholeJacobian(model)
    sizes = sizes_of_run(model, consistent_state(model, 0.0, None, None), t_end)
    rtol, *atol = settings.tolerances(model, sizes)
    with warnings.catch_warnings(action="ignore"):  # it says that it takes our Jacobian and makes none of its own
        solver = Solver(
            Correction(system, Counts(), settings.largest_order(model)).F,
            rtol=rtol,
            atol=system.tolerances(*atol),
            jacfn=jacobian,
            max_order=settings.largest_order(model),
            linsolver="sparse",
            sparsity=csc_matrix(jacobian.pattern),
            nthreads=1,
        )
    begin, t, steps = time.process_time(), 0.0, 0
    solver.init_step(0.0, *system.pack(consistent_state(model, 0.0, None, None)))
    while t < t_end:
        result = solver.step(t_end, method="onestep", tstop=t_end)
        if result.status < 0:
            raise RuntimeError(f"IDA, sparse: status {result.status} at t = {t:.4g} s: {result.message}")
        t, steps = float(result.t), steps + 1
    return {"cpu_s": time.process_time() - begin, "steps": steps, "setups": jacobian.calls}


class FirstOrder:
    """A scene in the stabilised index-1 form ggl1, F(t, y, y') = 0, with both its sparse Jacobians."""

    def __init__(self, model):
        self.model, self.calls = model, 0
        self.system = System(model, "ggl1", 0.0)
        self.equations = Correction(self.system, Counts(), 5)

    def residual(self, t, y, yp):
        """F, by the compiled residual."""
        res = np.empty(self.system.size)
        self.equations.F(t, np.ascontiguousarray(y), np.ascontiguousarray(yp), res)
        return res

    def jacobians(self, t, y, yp):
        """(dF/dy, dF/dy'), sparse."""
        from scipy.sparse import block_array, csc_array, eye_array

        model, (n, m) = self.model, (self.model.n, self.model.m)
        q, v, a, lam, mu = self.system.split(np.array(y), np.array(yp))
        B, unit = model.phi_q(t, q), eye_array(n)
        K, bent, slope = model.force_q(t, q, v), None, None
        if model.needs.driven:
            K, bent = K + model.reaction_q(t, q, lam), model.reaction_q(t, q, mu)
            slope = csc_array(FormRows(self.system, 0.0, t, q, v, a, lam).on_q[m:])
        wide, square = csc_array((n, m)), csc_array((m, m))
        in_y = [[bent, -unit, wide, wide], [K, None, None, None], [B, None, square, None], [slope, B, None, square]]
        in_yp = [[unit, None, None, B.T], [None, model.mass(), B.T, None], [wide.T, None, square, None], [None, wide.T, None, square]]
        return block_array(in_y, format="csc"), block_array(in_yp, format="csc")


def radau(model, times, rtol, watch):
    """solve_dae's Radau IIA of order 5 on form ggl1: (row of CPU seconds and counts, watched quantity at `times`).

    Absolute tolerances are those of IDA, and ten times that of v for the integrated multipliers.
    """
    try:
        from solve_dae.integrate import solve_dae
    except ImportError:
        raise Missing("solve_dae is not installed (extra peers)") from None
    first, n = FirstOrder(model), model.n
    start = consistent_state(model, 0.0, None, None)
    (y, yp), (length, speed) = first.system.pack(start), typical_sizes(model, start, times[-1])
    atol = rtol * np.repeat([length, speed, 10 * speed], [n, n, 2 * model.m])
    begin = time.process_time()
    solution = solve_dae(first.residual, (0.0, times[-1]), y, yp, method="Radau", rtol=rtol, atol=atol, t_eval=times, jac=first.jacobians)
    seconds = time.process_time() - begin
    if solution.status != 0:
        raise RuntimeError(f"solve_dae: {solution.message}")
    counts = {"residuals": int(solution.nfev), "tangents": int(solution.njev), "factorizations": int(solution.nlu)}
    return {"cpu_s": seconds} | counts, np.array([watch(q) for q in solution.y[:n].T])


class ExudynScene:
    """Forces, Jacobian and constraints of a scene as user functions of exudyn: a generic body and a vector constraint."""

    def __init__(self, model, watch):
        try:
            import exudyn
        except ImportError:
            raise Missing("exudyn is not installed (extra peers)") from None
        import exudyn.itemInterface as items

        self.exu, self.model, self.look = exudyn, model, watch
        self.rest, self.counts = np.zeros(model.n), {"residuals": 0, "tangents": 0}
        self.system = exudyn.SystemContainer().AddSystem()
        add, zero = self.system, [0.0] * model.n
        names = ("referenceCoordinates", "initialCoordinates", "initialCoordinates_t")
        body = add.AddNode(items.NodeGenericODE2(**dict.fromkeys(names, zero), numberOfODE2Coordinates=model.n))
        add.AddObject(
            items.ObjectGenericODE2(
                nodeNumbers=[body],
                massMatrix=self.container(model.mass()),
                forceUserFunction=self.force,
                jacobianUserFunction=self.stiffness,
            )
        )
        ground = add.AddNode(items.NodePointGround())
        markers = [add.AddMarker(items.MarkerNodeCoordinates(nodeNumber=node)) for node in (ground, body)]
        add.AddObject(
            items.ObjectConnectorCoordinateVector(
                markerNumbers=markers,
                scalingMarker0=np.zeros((model.m, 1)),
                constraintUserFunction=self.phi,
                jacobianUserFunction=self.phi_q,
            )
        )
        self.sensor = add.AddSensor(
            items.SensorUserFunction(sensorNumbers=[], writeToFile=False, storeInternal=True, sensorUserFunction=self.seen)
        )
        add.Assemble()

    def container(self, matrix):
        """A sparse matrix as exudyn takes it: without stored zeros."""
        from scipy.sparse import csr_matrix

        sparse, made = csr_matrix(matrix), self.exu.MatrixContainer()
        sparse.eliminate_zeros()
        made.SetWithSparseMatrix(sparse)
        return made

    def force(self, system, t, number, q, v):
        self.counts["residuals"] += 1
        return -self.model.force(t, np.array(q), self.rest)

    def stiffness(self, system, t, number, q, v, c_q, c_v):
        self.counts["tangents"] += 1
        return self.container(c_q * self.model.force_q(t, np.array(q), self.rest))

    def phi(self, system, t, number, q, v, velocity):
        q = np.array(q)
        return self.model.phi_q(t, q) @ np.array(v) + self.model.phi_t(t, q) if velocity else self.model.phi(t, q)

    def phi_q(self, system, t, number, q, v, velocity):
        return self.model.phi_q(t, np.array(q)).toarray()

    def seen(self, system, t, numbers, factors, configuration):
        return list(self.look(np.array(system.systemData.GetODE2Coordinates())))

    def run(self, times, h, modified):
        """Generalized-alpha (rho_inf 0.9, Eigen's sparse LU) to times[-1], evenly spaced: (row, watched quantity at `times`)."""
        exu, s = self.exu, self.exu.SimulationSettings()
        s.timeIntegration.numberOfSteps, s.timeIntegration.endTime = math.ceil(times[-1] / h - 1e-9), float(times[-1])
        s.timeIntegration.generalizedAlpha.spectralRadius = 0.9
        s.timeIntegration.newton.useModifiedNewton = modified
        s.timeIntegration.verboseMode, s.parallel.numberOfThreads = 0, 1
        with warnings.catch_warnings(action="ignore"):  # newer versions have other names as well
            s.solutionSettings.writeSolutionToFile = False
            s.solutionSettings.sensorsWritePeriod = float(times[1] - times[0])
            s.linearSolverType = exu.LinearSolverType.EigenSparse
        begin = time.process_time()
        done = exu.SolveDynamic(self.system, s, solverType=exu.DynamicSolverType.GeneralizedAlpha)
        seconds = time.process_time() - begin
        if not done:
            raise RuntimeError("exudyn did not converge")
        row = {"cpu_s": seconds, "steps": s.timeIntegration.numberOfSteps} | self.counts
        return row, np.array(self.system.GetSensorStoredData(self.sensor))[:, 1:]


BACKENDS = {
    "superlu": superlu,
    "band": band,
    "pardiso": pardiso,
    "pardiso single": lambda model, blocks: pardiso(model, blocks, np.float32),
}
