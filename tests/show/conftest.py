import pytest

from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.ida.integrator import IDA
from polyida.problems import plates
from polyida.run.solve import solve


@pytest.fixture(scope="session")
def model():
    return plates.double_plate_motors(cells=10).build()


@pytest.fixture(scope="session")
def runs(model):
    members = {"generalized-alpha": GeneralizedAlpha(h=2e-3), "IDA": IDA(rtol=1e-4)}
    return {label: solve(model, 0.04, member) for label, member in members.items()}


@pytest.fixture(scope="session")
def run(runs):
    return runs["generalized-alpha"]
