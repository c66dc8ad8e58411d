"""A step is solved as exactly as what it has to resolve asks for."""

from types import SimpleNamespace

import pytest

from pgran.solve.tolerances import SHARE, Tolerances


class Solver:
    """The part of SNES, and of its KSP, that knows tolerances."""

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
    """The tolerances of the linear systems at iterates with these norms of the residual."""
    found = []
    for solver.norm in norms:
        tolerances.next(solver)
        found.append(solver.rtol)
    return found


def test_the_residual_stays_small_against_the_perturbation_that_grows():
    solver = Solver()
    tolerances, found = Tolerances(solver, 1.0, 1e-3), []
    for perturbation in (0.0, 1e-6, 1e-2, 0.5, 1.0, 3.0):
        tolerances.begin(solver, perturbation)
        found.append(solver.atol)
    assert found == pytest.approx([1e-7, 1e-7, 1e-6, 5e-5, 1e-4, 1e-4])


def test_linear_systems_follow_newtons_method_and_are_not_solved_beyond_need():
    solver = Solver()
    tolerances = Tolerances(solver, 1.0, 1e-3)
    tolerances.begin(solver, 1.0)
    first, slow, fast, last = linear(tolerances, solver, 10.0, 5.0, 5e-2, 5e-4)
    assert first == slow == last == 3e-2  # the options have the loosest
    assert fast == pytest.approx(1e-2**1.5)
    assert linear(tolerances, solver, 5e-5 * 1e3, 2e-3)[1] == pytest.approx(SHARE * 1e-4 / 2e-3)


def test_zero_leaves_the_tolerances_as_the_options_have_them():
    solver = Solver()
    tolerances = Tolerances(solver, 0.0, 1e-3)
    tolerances.begin(solver, 1e-6)
    assert linear(tolerances, solver, 1.0, 1e-3) == [3e-2, 3e-2] and solver.atol == 1e-4
