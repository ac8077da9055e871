"""Runs over a parameter: one after the other, on this machine's processes, on a Dask cluster; the same rows each time."""

import concurrent.futures
import pickle

import numpy as np

import polyida as pi


def build(stiffness):
    mesh, rubber = pi.mesh.rectangle(1.0, 0.1, cells=40, seed=1), pi.Material(E=stiffness, nu=0.3, rho=1100.0)
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.Plate(mesh, rubber, thickness=0.01, name="bar"))
    scene.add(pi.AngleMotor(pi.ground, bar.section("left"), pi.profile.quintic(0.0, 0.5, 0.1), name="motor"))
    scene.add(pi.Revolute(pi.ground, bar.section("left")))
    scene.add(pi.PointMass(bar.section("right"), 0.1, name="tip"))
    return scene


def case(stiffness):
    run = pi.solve(build(stiffness).build(), 0.1, pi.GeneralizedAlpha(h=1e-3))
    x, y = run.position("tip")[-1]
    return {"x": x, "y": y, "steps": run.counts.steps}


def main():
    for thing in (
        build(50e6),
        build(50e6).build(),
        pi.solve(build(50e6).build(), 0.01, pi.GeneralizedAlpha(h=1e-3)),
        pi.profile.ramp(0.0, 1.0, 0.1),
    ):
        pickle.loads(pickle.dumps(thing))
    cases = [{"stiffness": float(E)} for E in np.geomspace(2e7, 2e9, 4)]
    serial = pi.study.sweep(case, cases)
    assert [row["stiffness"] for row in serial.rows] == [c["stiffness"] for c in cases]
    with concurrent.futures.ProcessPoolExecutor(2) as pool:
        parallel = pi.study.sweep(case, cases, executor=pool)
    close = lambda a, b: all(abs(p["x"] - q["x"]) < 1e-12 and abs(p["y"] - q["y"]) < 1e-12 for p, q in zip(a.rows, b.rows))  # noqa: E731
    assert close(serial, parallel)
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        print("sweep: distributed is not installed, the cluster was left out")
        return
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        spread = pi.study.sweep(case, cases, executor=client.get_executor(), folder="sweep-rows")
    assert close(serial, spread)
    again = pi.study.sweep(case, cases, folder="sweep-rows")  # what is there is not run again
    assert close(serial, again) and again.ran == 0
    print(serial.to_dataframe().head())


if __name__ == "__main__":
    main()
