"""Nonlinear and linear tolerances of a time step."""

from types import SimpleNamespace

import pytest

from pgran.solve.tolerances import SHARE, Tolerances


class Solver:
    """The tolerances of SNES and of its KSP."""

    def __init__(self, atol=1e-4, rtol=3e-2):
        self.atol, self.rtol, self.norm = atol, rtol, None
        self.ksp = SimpleNamespace(getTolerances=lambda: (self.rtol, 0.0, 0.0, 40),
                                   setTolerances=self._set_linear)

    def _set_linear(self, rtol):
        self.rtol = rtol

    def getKSP(self):
        return self.ksp

    def getTolerances(self):
        return 1e-8, self.atol, 0.0, 12

    def setTolerances(self, atol):
        self.atol = atol

    def getFunctionNorm(self):
        return self.norm


def linear(tolerances, solver, *norms):
    """Return the linear tolerances for these norms of the residual."""
    found = []
    for solver.norm in norms:
        tolerances.next(solver)
        found.append(solver.rtol)
    return found


def test_the_tolerance_is_proportional_to_the_growing_perturbation():
    solver = Solver()
    tolerances, found = Tolerances(solver, 1.0, 1e-3), []
    for perturbation in (0.0, 1e-6, 1e-2, 0.5, 1.0, 3.0):
        tolerances.begin(solver, perturbation)
        found.append(solver.atol)
    assert found == pytest.approx([1e-7, 1e-7, 1e-6, 5e-5, 1e-4, 1e-4])


def test_linear_tolerances_follow_the_convergence_of_newtons_method():
    solver = Solver()
    tolerances = Tolerances(solver, 1.0, 1e-3)
    tolerances.begin(solver, 1.0)
    first, slow, fast, last = linear(tolerances, solver, 10.0, 5.0, 5e-2, 5e-4)
    assert first == slow == last == 3e-2  # the value of the options is the upper bound
    assert fast == pytest.approx(1e-2**1.5)
    assert linear(tolerances, solver, 5e-5 * 1e3, 2e-3)[1] == pytest.approx(SHARE * 1e-4 / 2e-3)


def test_zero_keeps_the_tolerances_of_the_options():
    solver = Solver()
    tolerances = Tolerances(solver, 0.0, 1e-3)
    tolerances.begin(solver, 1e-6)
    assert linear(tolerances, solver, 1.0, 1e-3) == [3e-2, 3e-2] and solver.atol == 1e-4
