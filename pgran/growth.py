"""Why a specimen localises: growth rates of the linearised time step on the moving mesh.

    python -m pgran.growth -options_file options/growth.opts [-dt 1e-3,5e-4] [-without faces]
        [-mode NAME.h5]

A step takes the mesh, the stress and the unknowns of one time to those of the next.
About homogeneous flow its linearisation has multipliers m, and log(m)/dt are growth
rates, which must not depend on the step: unlike the spectra of `pgran.eigen` they
contain the motion of the mesh and the elastic memory. SLEPc finds the largest
multipliers matrix-free, each product one solution with the Jacobian of the step.
``-without`` leaves parts of the coupling out, one or several with commas: ``faces`` (the
lateral stress does not follow the disturbed faces), ``geometry`` (elements keep their
undisturbed shape), ``interior`` (only nodes of the lateral faces are where the disturbance
takes them), ``spin`` (the stress does not turn with the disturbance), ``memory`` (the
stress of the step before is undisturbed).

``-mode`` writes the fastest mode of the last step as a result file with a picture: on a shape
displaced by at most `SHOWN`, the fields ``displacement`` (d), ``velocity`` (d gdot0), ``fluidity``
and ``pressure`` of a disturbance whose largest displacement is 1 d.
The last line is the growth rate of a column that creeps (`column_growth_rate`).
``-json`` prints a list of the step and its rates as [real, imaginary]. A good run
prints growth rates that agree between the steps. Units of gdot0.
"""

import json
import sys

import numpy as np

from . import rheology
from .options import OptionError, Settings

OWN = ("dt", "without", "mode", "json")
PARTS = "faces", "geometry", "interior", "spin", "memory"
#: Size of the disturbances that are differenced, in d, |sigma_1| and gdot0.
SIZE = 1e-5
#: Largest displacement of the shape on which a mode is shown, d.
SHOWN = 2.0


def column_growth_rate(settings, half_waves=None):
    """Return the growth rate, gdot0, at which a specimen sways as a column does that creeps.

    It leans in ``half_waves`` n half sine waves, k = n pi/H: 1 where plates let it slip, else 2.
    They press with N beyond the lateral stress; E is the tangent viscosity of the axial stress::

        phi rho_s L r^2 + E (L^3/12) k^4 r - N k^2 = 0,    N = (|sigma_2| - |sigma_1|) L = 2 mu P0 L
        E = 4 M P0^2/|sigma_1|,    M = I0 mu_loc'(I0) + A^2 d^2 (12/L^2 + k^2)

    NGF: a fluidity that varies across the width ends at faces without flux, in layers of
    A d/sqrt(mu), which adds the 12/L^2 to bending; LI has no such term. For H >= 3 L.
    """
    law, material = rheology.law_of(settings), rheology.material_of(settings)
    mu, slope = law.stress_ratio(settings.inertial_number)
    half_waves = half_waves or (1 if settings.plates_slip else 2)
    P, L, k = material.pressure, settings.width, half_waves * np.pi / settings.height
    M = settings.inertial_number * slope
    if settings.model == "ngf":
        M = M + settings.A**2 * (12.0 / L**2 + k**2)
    inertia = material.bulk_density * L if settings.inertia else 0.0
    bending, load = 4.0 * M * P**2 * L**3 / 12.0 * k**4, 2.0 * mu * P * L * k**2
    # The positive root, in the form that needs no inertia.
    return float(2.0 * load / (bending + np.sqrt(bending**2 + 4.0 * inertia * load)))


class LinearisedStep:
    """The derivative of one step (backward Euler, trapezoidal mesh) about homogeneous flow.

    Parameters: ``form``, the step ``dt`` (1/gdot0), ``without`` parts of the coupling. A
    disturbance is one array: mesh (2 n_nodes), unknowns (n_local), stress (27 n_elements) of
    this rank, ghosts included. Collective.
    """

    def __init__(self, form, dt, without=()):
        from petsc4py import PETSc

        from . import evolve

        self.form, self.dt, self.without, self.evolve = form, dt, without, evolve
        grid = form.grid
        self.state = evolve.homogeneous(form)
        self.base, self.angle = evolve.setting(form, self.state, dt)
        self.inside = np.ones(grid.nodes.size, dtype=bool)
        for side in form.case.side_stresses:
            self.inside[grid.side_nodes(side)] = False
        self.lengths = np.cumsum([2 * grid.nodes.size, grid.n_local])
        self.size = int(self.lengths[-1]) + 27 * grid.n_elements
        self.matrix, self.right = form.create_matrix(), grid.create_vector()
        self.update = self.right.duplicate()
        self.ksp = PETSc.KSP().create(comm=grid.comm)
        self.ksp.setOptionsPrefix("step_")
        self.ksp.setOperators(self.matrix)
        self.ksp.setType("preonly")
        self.ksp.getPC().setType("lu")
        self.ksp.getPC().setFactorSolverType("mumps")
        self.ksp.setFromOptions()
        _, fluidity, pressure = grid.split(self.state.local)
        flow = form.case.start(self.base.x)
        self.end = grid.join(flow, fluidity, pressure)
        for _ in range(10):
            form.jacobian(self.end, 1.0 / dt, self.base, self.matrix)
            self.ksp.setOperators(self.matrix)
            change = self._newton(self.end, self.state, self.base)
            self.end = self.end + change
            if np.abs(change).max(initial=0.0) < 1e-12 * np.abs(self.end).max():
                break

    def _newton(self, local, state, step):
        rows = self.form.residual(local, (local - state.local) / self.dt, step)
        self.right.setArray(-rows)
        self.ksp.solve(self.right, self.update)
        return self.form.grid.to_local(self.update)

    def _advanced(self, disturbance):
        """Mesh, unknowns and stress at the end, to first order in the disturbance, as one array."""
        from .weakform import Step

        state, form = self.state, self.form
        x, local, stress = np.split(disturbance, self.lengths)
        start = self.evolve.State(state.time, state.x + x.reshape(2, -1), state.local + local,
                                  state.stress + stress.reshape(state.stress.shape))
        step, _ = self.evolve.setting(form, start, self.dt)
        if "spin" in self.without:
            step.stress = start.past(self.dt, self.angle)[1]
        if "memory" in self.without:
            step.stress = self.base.stress
        if "interior" in self.without:
            x = np.where(self.inside, self.base.x, step.x)
            step = Step(form, x, step.stress, step.theta, step.prescribed, step.prescribed_rate)
        if "faces" in self.without:
            step.load = self.base.load
        if "geometry" in self.without:
            step.geometry = self.base.geometry
        end = self.end + self._newton(self.end, start, step)
        return np.concatenate([self.evolve.moved(form, start, step, end, self.dt).ravel(), end,
                               form.stress(end, step).ravel()])

    def apply(self, direction):
        """Return the derivative in a direction (size,), by central differences. Collective."""
        from mpi4py import MPI

        largest = self.form.grid.comm.tompi4py().allreduce(
            np.abs(direction).max(initial=0.0), MPI.MAX)
        scale = SIZE / (largest or 1.0)
        ahead, behind = (self._advanced(sign * scale * direction) for sign in (1.0, -1.0))
        return (ahead - behind) / (2.0 * scale)

    def mult(self, matrix, x, y):
        """Multiply, as PETSc's matrices of type Python do."""
        y.setArray(self.apply(x.array_r))


def fastest_modes(form, dt, without=(), count=4):
    """Return the fastest growth rates (complex, gdot0) of a form's step and their modes.

    Fastest first; a mode is a `LinearisedStep` disturbance (size,), complex. Solver
    options have the prefixes ``-eps_`` and ``-step_``. Collective.
    """
    from petsc4py import PETSc
    from slepc4py import SLEPc

    step, comm = LinearisedStep(form, dt, without), form.grid.comm
    shell = PETSc.Mat().createPython(((step.size, None), (step.size, None)), step, comm=comm)
    shell.setUp()
    eps = SLEPc.EPS().create(comm=comm)
    eps.setOperators(shell)
    eps.setProblemType(SLEPc.EPS.ProblemType.NHEP)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_MAGNITUDE)
    eps.setDimensions(count, max(40, 4 * count))
    eps.setTolerances(1e-6, 100)
    eps.setFromOptions()
    eps.solve()
    found, (real, imaginary) = [], shell.createVecs()
    for k in range(eps.getConverged()):
        multiplier = complex(eps.getEigenpair(k, real, imaginary))
        found.append((complex(np.log(multiplier) / dt), real.array + 1j * imaginary.array))
    return sorted(found, key=lambda mode: -mode[0].real)


def write_mode(path, settings, form, rate, mode):
    """Write a mode as the module's docstring tells; return the files. Collective.

    Raises `OptionError` where that cannot be done.
    """
    from .results import Writer

    grid = form.grid
    x = form.case.coordinates(grid.nodes.i, grid.nodes.j)
    mode = (mode / grid.largest(mode[:x.size])).real
    velocity, fluidity, pressure = grid.split(mode[x.size:x.size + grid.n_local])
    displacement = mode[:x.size].reshape(x.shape)
    fields = {"coordinates": x + SHOWN * displacement, "displacement": displacement,
              "velocity": velocity, "pressure": form.corner_field(pressure)}
    if fluidity is not None:
        fields["fluidity"] = fluidity
    writer = Writer(path, grid, settings, {"growth_rate": rate.real, "complete": True})
    writer.snapshot(0.0, 0.0, fields)

    def picture():
        from . import plot

        shown = "fluidity" if "fluidity" in fields else "pressure"
        return plot.field(path, "0000", shown, f"{shown} of the fastest mode")

    return writer.path, writer.path.with_suffix(".xdmf"), writer.root_only(picture)


def main(arguments):
    """Run with the command line ``arguments``; return the exit code. Collective."""
    from .__main__ import command

    return command(arguments, run, __doc__, slepc=True)


def run(settings, comm):
    """Answer the command line; raises `OptionError`. Collective."""
    from petsc4py import PETSc

    from .weakform import discretise

    database = PETSc.Options()
    own = {name: database.getString(name, "") for name in OWN if database.hasName(name)}
    without = tuple(own.get("without", "").split(",")) if own.get("without") else ()
    if set(without) - set(PARTS):
        raise OptionError(f"-without {own['without']}: allowed is {' | '.join(PARTS)}")
    try:
        steps = [float(part) for part in own.get("dt", "1e-3").split(",")]
    except ValueError:
        steps = [0.0]
    if min(steps) <= 0.0:
        raise OptionError(f"-dt {own['dt']}: allowed is a list of numbers > 0")
    if own.get("mode") == "":
        raise OptionError("-mode: allowed is the name of a file")
    form = discretise(Settings(**{**vars(settings), "imperfection": 1.0}), comm)
    rows = []
    for dt in steps:
        modes = fastest_modes(form, dt, without)
        rows.append({"dt": dt, "growth_rates": [[rate.real, rate.imag] for rate, _ in modes]})
    files = write_mode(own["mode"], settings, form, *modes[0]) if modes and "mode" in own else ()
    if comm.rank:
        return
    if "json" in own:
        print(json.dumps(rows))
        return
    for row in rows:
        shown = "  ".join(f"{real:.4g}{imaginary:+.3g}i" if imaginary else f"{real:.4g}"
                          for real, imaginary in row["growth_rates"])
        print(f"  dt {row['dt']:.3g}: {shown or 'no multiplier converged'}")
    if settings.case == "biaxial":
        print(f"  a column: {column_growth_rate(settings):.4g}")
    if files:
        print("  mode: " + ", ".join(map(str, files)))


if __name__ == "__main__":
    sys.exit(main(sys.argv))
