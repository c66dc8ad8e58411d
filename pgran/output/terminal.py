"""Terminal output of a run, on rank 0."""

import os
import shutil
import sys
import time

from petsc4py import PETSc

from .. import __version__
from . import progress


class Terminal:
    """Prints the problem and the solver, the progress of a run, and where the results are.

    ``detail`` is steps, brief (one line per 2 % of the run or 30 s) or quiet.
    """

    def __init__(self, comm, detail):
        self.shown = comm.rank == 0 and detail != "quiet"
        self.detail, self.comm = detail, comm
        self.start = self.last = time.monotonic()
        self._mark, self._done, self._spent = None, [], []

    def say(self, text):
        """Print ``text`` on rank 0 unless the run is quiet."""
        if self.shown:
            print(text, flush=True)

    def opening(self, form, ts):
        """Print the problem and the solver. Collective."""
        grid, snes, parameters = form.grid, ts.getSNES(), form.case.parameters
        ksp = snes.getKSP()
        pc = ksp.getPC()
        solver = f" ({pc.getFactorSolverType()})" if pc.getType() in ("lu", "cholesky") else ""
        unknowns, ranks = self.comm.tompi4py().allreduce(grid.n_owned), self.comm.size
        self.say(
            f"pgran {__version__} on PETSc {'.'.join(map(str, PETSc.Sys.getVersion()))}: "
            f"{parameters.case}, {parameters.model}, {parameters.law}\n"
            f"  {unknowns} unknowns, {grid.shape[0]} x {grid.shape[1]} Q2-Q1 elements, {ranks} "
            f"rank{'s' if ranks > 1 else ''}; I0 = {parameters.inertial_number:g}, "
            f"G = {parameters.shear_modulus:g} {form.case.stress_unit}\n"
            f"  TS {ts.getType()}, SNES {snes.getType()}, KSP {ksp.getType()}, "
            f"PC {pc.getType()}{solver}")

    def step(self, number, done, text, report):
        """Report a step: its number, the progress (0 to 1), its label, and the history row."""
        now, mark = time.monotonic(), int(50 * done)
        self._done.append(done)
        self._spent.append(now - self.start)
        if self.detail == "brief" and mark == self._mark and now - self.last < 30.0:
            return
        self._mark, self.last = mark, now
        seconds = progress.left(self._done, self._spent) if done >= progress.EARLY else None
        left = f"  {progress.words(seconds):>6} left" if seconds is not None else ""
        self.say(f"  {text}  {progress.step_text(number, report)}{left}")

    def closing(self, writer, cost, further):
        """Print the cost of the run, where the results are, and useful next commands."""
        path, python = writer.path, sys.executable
        if os.path.dirname(shutil.which("python") or "") == os.path.dirname(python):
            python = "python"
        self.say(f"  {cost['steps']} steps ({cost['steps_repeated']} repeated smaller), "
                 f"{cost['newton_iterations']} Newton and {cost['linear_iterations']} linear "
                 f"iterations, {cost['seconds']:.1f} s, {cost['memory']:.0f} MB\n"
                 f"  results: {path}, {path.with_suffix('.xdmf')}\n"
                 f"  next: {python} -m pgran.plot {path}\n"
                 f"        {python} -m {further} {path}\n"
                 f"        {python} -c 'import pgran; print(pgran.open(\"{path}\").history)'")
