"""One time step from the state of a snapshot, on any mesh: what it costs, system by system.

    mpiexec -n 2 python jobs/bench/one_step.py -options_file options/biaxial.opts \
        -pgran_element_size 0.5 -from results/biaxial.h5 -snapshot 1 -dt 1e-3 [-name text]

The fields of the snapshot, which may stem from a coarser mesh whose elements this one
divides, are interpolated to this mesh, and one step of ``-dt`` (1/gdot0) is solved
from there. Rank 0 prints one line of JSON: for each Newton iteration the residual, the
linear iterations and the seconds of Jacobian, preconditioner and solution; and the peak
memory of the ranks. PETSc's options hold.
"""

import json
import resource
import sys
import time

import h5py
import numpy as np
from mpi4py import MPI

from pgran.__main__ import start
from pgran.element import SHAPE, linear, quadratic
from pgran.options import OptionError


def along(fine, coarse, index, nodal):
    """Weights (n, m) of m nodes of a coarse grid at nodes ``index`` (n,) of a fine one, 1D.

    ``coarse`` and ``fine`` count elements; ``nodal`` functions on two (Q1) or three (Q2) nodes.
    """
    ratio = 2 * fine // coarse
    element = np.minimum(index // ratio, coarse - 1)
    weights = nodal(2.0 * (index - ratio * element) / ratio - 1.0)
    per_element = weights.shape[1] - 1
    table = np.zeros((index.size, per_element * coarse + 1))
    for k in range(per_element + 1):
        table[np.arange(index.size), per_element * element + k] = weights[:, k]
    return table


def interpolated(form, path, number):
    """Return the `State` on the grid of ``form`` from a snapshot of a mesh that it divides."""
    from pgran.evolve import State

    grid, nodes, corners = form.grid, form.grid.nodes, form.grid.corners
    with h5py.File(path, "r") as file:
        group = file["snapshots"][sorted(file["snapshots"])[number]]
        fields = {name: group[name][...] for name in (
            "coordinates", "velocity", "fluidity", "pressure", "deviator")}
        moment = float(group.attrs["time"])
    coarse = [(size - 1) // 2 for size in fields["fluidity"].shape[::-1]]
    if any(n % m for n, m in zip(grid.shape, coarse)):
        raise OptionError(f"-from {path}: its {coarse[0]} x {coarse[1]} elements are not "
                          f"divided by the {grid.shape[0]} x {grid.shape[1]} of this grid")

    def at(values, lattice, factor, nodal):
        (i0, i1), (j0, j1) = ((index.min(), index.max() + 1) for index in (lattice.i, lattice.j))
        first, second = (along(n, m, factor * np.arange(*span), nodal) for n, m, span in zip(
            grid.shape, coarse, ((i0, i1), (j0, j1))))
        values = values.reshape(values.shape[:2] + (-1,))
        return np.einsum("ja,abc,ib->cji", second, values, first, optimize=True).reshape(
            values.shape[2], -1)

    def q2(x):
        return quadratic(x)[0]

    pressure = at(fields["pressure"][::2, ::2], corners, 2, linear)[0]
    x, velocity, deviator = (at(fields[name], nodes, 1, q2)
                             for name in ("coordinates", "velocity", "deviator"))
    fluidity = np.maximum(at(fields["fluidity"], nodes, 1, q2)[0], fields["fluidity"].min())
    return State(moment, x, grid.join(velocity, fluidity, pressure),
                 SHAPE @ deviator[:, grid.element_nodes])


def one_step(settings, comm, path, number, dt):
    """Solve one step and return what it took, a dictionary. Collective."""
    from pgran import evolve, weakform

    ranks = comm.tompi4py()
    begin = time.perf_counter()
    form = weakform.discretise(settings, comm)
    settings.step_first = dt
    settings.step_error = 1e10
    state = interpolated(form, path, number)
    evolution = evolve.Evolution(form, settings, state, [state.time + dt], lambda *_: None)
    snes = evolution.ts.getSNES()
    rows, spent = [], {"jacobian": 0.0, "residual": 0.0}

    def timed(name, method):
        def call(*arguments):
            started = time.perf_counter()
            method(*arguments)
            spent[name] += time.perf_counter() - started
        return call

    evolution.ts.setIFunction(timed("residual", evolution._ifunction),
                              evolution._residual_vector)
    evolution.ts.setIJacobian(timed("jacobian", evolution._ijacobian), evolution.matrix,
                              evolution.matrix)

    def monitor(snes, iteration, norm):
        ksp = snes.getKSP()
        rows.append({"residual": norm, "iterations": ksp.getIterationNumber() if iteration else 0,
                     "seconds": time.perf_counter(), **spent})

    snes.setMonitor(monitor)
    ready = time.perf_counter()
    evolution.solve()
    for before, after in reversed(list(zip(rows, rows[1:]))):
        for key in ("seconds", "jacobian", "residual"):
            after[key] -= before[key]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"unknowns": evolution.matrix.getSize()[0], "ranks": comm.size,
            "element_size": settings.element_size, "newton": rows[1:], "set_up": ready - begin,
            "memory": ranks.allreduce(memory, MPI.MAX), "memory_sum": ranks.allreduce(memory)}


def main():
    def action(settings, comm):
        from petsc4py import PETSc

        database = PETSc.Options()
        found = one_step(settings, comm, database.getString("from"),
                         database.getInt("snapshot", -1), database.getReal("dt", 1e-3))
        found["name"] = database.getString("name", "")
        if comm.rank == 0:
            print(json.dumps(found), flush=True)

    return start(sys.argv, action)


if __name__ == "__main__":
    sys.exit(main())
