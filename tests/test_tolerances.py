"""Nonlinear and linear tolerances of a time step."""

import pytest
from petsc4py import PETSc

from pgran.solve.tolerances import SHARE, Tolerances


class Solver(PETSc.SNES):
    """A solver with tolerances and with a given norm of the residual."""

    norm = None

    def getFunctionNorm(self):
        return self.norm


@pytest.fixture
def solver():
    solver = Solver().create(PETSc.COMM_SELF)
    solver.setTolerances(atol=1e-4)
    solver.getKSP().setTolerances(rtol=3e-2)
    return solver


def linear(tolerances, solver, *norms):
    """Return the linear tolerances for these norms of the residual."""
    found = []
    for solver.norm in norms:
        tolerances.next(solver)
        found.append(solver.getKSP().getTolerances()[0])
    return found


def test_the_tolerance_is_proportional_to_the_growing_perturbation(solver):
    tolerances, found = Tolerances(solver, 1.0, 1e-3), []
    for perturbation in (0.0, 1e-6, 1e-2, 0.5, 1.0, 3.0):
        tolerances.begin(solver, perturbation)
        found.append(solver.getTolerances()[1])
    assert found == pytest.approx([1e-7, 1e-7, 1e-6, 5e-5, 1e-4, 1e-4])


def test_linear_tolerances_follow_the_convergence_of_newtons_method(solver):
    tolerances = Tolerances(solver, 1.0, 1e-3)
    tolerances.begin(solver, 1.0)
    first, slow, fast, last = linear(tolerances, solver, 10.0, 5.0, 5e-2, 5e-4)
    assert first == slow == last == 3e-2  # the value of the options is the upper bound
    assert fast == pytest.approx(1e-2**1.5)
    assert linear(tolerances, solver, 5e-5 * 1e3, 2e-3)[1] == pytest.approx(SHARE * 1e-4 / 2e-3)


def test_zero_keeps_the_tolerances_of_the_options(solver):
    tolerances = Tolerances(solver, 0.0, 1e-3)
    tolerances.begin(solver, 1e-6)
    assert linear(tolerances, solver, 1.0, 1e-3) == [3e-2, 3e-2]
    assert solver.getTolerances()[1] == 1e-4
