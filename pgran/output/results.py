"""Result files: HDF5 with snapshots and history, and XDMF beside it.

``/snapshots/NNNN`` holds fields on the grid of Q2 nodes (row = x2 index),
``/history`` one entry for each accepted step, the root attributes the resolved
options, the versions and the scales. The file is closed after each writing, so a
run that stops later loses nothing that was written.
"""

import os
from pathlib import Path
from xml.sax.saxutils import quoteattr

import h5py
import numpy as np
from petsc4py import PETSc

from .. import __version__, cases
from ..options import PREFIX, ParameterError, written

#: The columns of the history that every run has; a case adds its observables.
HISTORY = ("time", "step_size", "newton_iterations", "linear_iterations", "inertial_number_min",
           "inertial_number_max")
INTEGERS = ("newton_iterations", "linear_iterations")


class Writer:
    """Writes the results of a run. Every method is collective.

    An earlier file of the same name is kept: it is renamed with a number.

    Parameters
    ----------
    path : str or Path
        The result file.
    form : pgran.space.weakform.WeakForm
        What is solved: its grid, and its case with the resolved parameters.
    attributes : dict, optional
        Further root attributes.
    option : tuple of str
        Name and prefix of the option that named the file, for messages.

    Raises
    ------
    ParameterError
        If the file cannot be made.
    """

    def __init__(self, path, form, attributes=None, option=("output", PREFIX)):
        self.path, self.grid, self.case, self._option = Path(path), form.grid, form.case, option
        self.comm = self.grid.comm.tompi4py()
        self.kept = self.root_only(self._make_room)
        self._history = {name: [] for name in (*HISTORY, *self.case.observables)}
        self.snapshots = []
        with self._open("w") as file:
            file.attrs["options"] = self.case.parameters.text()
            file.attrs["pgran_version"] = __version__
            file.attrs["petsc_version"] = ".".join(map(str, PETSc.Sys.getVersion()))
            for name, value in {**self.case.scales(), **(attributes or {})}.items():
                file.attrs[name] = value
            file.create_group("snapshots")
            history = file.create_group("history")
            for name in self._history:
                history.create_dataset(name, shape=(0,), maxshape=(None,), chunks=(1024,),
                                       dtype="i8" if name in INTEGERS else "f8")

    def root_only(self, action):
        """Do ``action`` on rank 0; every rank gets its answer, or its `ParameterError`."""
        answer = error = None
        if self.comm.rank == 0:
            try:
                answer = action()
            except OSError as problem:
                error = str(problem.strerror or problem)
        answer, error = self.comm.bcast((answer, error))
        if error:
            raise ParameterError(self._option[0], self.path, error, self._option[1])
        return answer

    def _make_room(self):
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if not os.access(self.path.parent, os.W_OK) or self.path.is_dir():
            raise OSError("cannot be written")
        if not self.path.exists():
            return None
        number = 1
        while (kept := self.path.with_suffix(f".{number}{self.path.suffix}")).exists():
            number += 1
        self.path.rename(kept)
        xdmf = self.path.with_suffix(".xdmf")
        if xdmf.exists():
            text = xdmf.read_text().replace(self.path.name + ":", kept.name + ":")
            kept.with_suffix(".xdmf").write_text(text)
        return str(kept)

    def _open(self, mode):
        return open_file(self.path, mode, self.comm, self._option)

    def record(self, **values):
        """Add an accepted step to the history; `snapshot` and `flush` write it."""
        for name, column in self._history.items():
            column.append(values[name])

    def snapshot(self, time, fields):
        """Write the history, and fields at the local nodes, {name: (..., n)}.

        One of the fields is ``coordinates``.
        """
        lattice = self.grid.nodes
        shape = lattice.shape[::-1]
        block = (slice(lattice.j0, lattice.j1), slice(lattice.i0, lattice.i1))
        inner = lattice.j1 - lattice.j0, lattice.i1 - lattice.i0
        name = f"{len(self.snapshots):04d}"
        with self._open("a") as file:
            group = file["snapshots"].create_group(name)
            group.attrs["time"], group.attrs["label"] = time, self.case.label(time)
            group.attrs[self.case.counted_by] = self.case.count(time)
            for key, value in fields.items():
                components = value.shape[:-1]
                data = group.create_dataset(key, shape + components, dtype="f8")
                local = value[..., lattice.owned].T.reshape(inner + components)
                if self.comm.size > 1:
                    with data.collective:
                        data[block] = local
                else:
                    data[block] = local
            self._write_history(file)
        self.snapshots.append((name, time))
        self.root_only(lambda: write_xdmf(
            self.path, shape, self.snapshots,
            {key: value.shape[:-1] for key, value in fields.items() if key != "coordinates"}))

    def flush(self, **attributes):
        """Write the history, and root attributes."""
        with self._open("a") as file:
            self._write_history(file)
            for name, value in attributes.items():
                file.attrs[name] = value

    def _write_history(self, file):
        for name, values in self._history.items():
            data = file["history"][name]
            if data.shape[0] < len(values):
                data.resize((len(values),))
                if self.comm.rank == 0:
                    data[...] = values


def open_file(path, mode, comm, option):
    """Open the HDF5 file that an option names on all ranks of an mpi4py communicator. Collective.

    ``option`` = (name, prefix).

    Raises `ParameterError` where h5py cannot do so.
    """
    if comm.size == 1:
        return h5py.File(path, mode)
    if not h5py.get_config().mpi:
        raise ParameterError(option[0], path, f"{comm.size} ranks need an h5py built with MPI",
                             option[1])
    return h5py.File(path, mode, driver="mpio", comm=comm)


def write_xdmf(path, shape, snapshots, fields):
    """Write NAME.xdmf, a time series of the snapshots, whole or not at all.

    ``shape`` = (ny, nx) nodes, ``snapshots`` pairs (group name, time), ``fields``
    {name: shape of its components}.
    """
    path = Path(path)
    size = " ".join(map(str, shape))

    def item(name, group, components):
        dimensions = " ".join(map(str, (*shape, *components)))
        target = quoteattr(f"{path.name}:/snapshots/{group}/{name}")[1:-1]
        return (f'<DataItem Dimensions="{dimensions}" NumberType="Float" Precision="8" '
                f'Format="HDF">{target}</DataItem>')

    lines = ['<?xml version="1.0"?>', '<Xdmf Version="2.0">', "<Domain>",
             '<Grid Name="pgran" GridType="Collection" CollectionType="Temporal">']
    for group, time in snapshots:
        lines += [f'<Grid Name="{group}" GridType="Uniform"><Time Value="{time:.16g}"/>',
                  f'<Topology TopologyType="2DSMesh" Dimensions="{size}"/>',
                  f'<Geometry GeometryType="XY">{item("coordinates", group, (2,))}</Geometry>']
        lines += [f'<Attribute Name="{name}" AttributeType="{"Matrix" if components else "Scalar"}"'
                  f' Center="Node">{item(name, group, components)}</Attribute>'
                  for name, components in fields.items()]
        lines.append("</Grid>")
    lines += ["</Grid>", "</Domain>", "</Xdmf>"]
    draft = path.with_suffix(".xdmf.tmp")
    draft.write_text("\n".join(lines) + "\n")
    draft.replace(path.with_suffix(".xdmf"))


def read_snapshot(parameters, form):
    """Return the snapshot that a restart names: its attributes, and {name: (..., n)}. Collective.

    The fields are those of `Writer.snapshot` at the local nodes of the form's grid.

    Raises
    ------
    ParameterError
        If the file, the snapshot, its grid or its physics does not fit.
    """
    return _read_fields(parameters, "restart", parameters.restart_snapshot, form,
                        ("coordinates", "velocity", "pressure", "fluidity", "deviator"))


def read_mode(parameters, form):
    """Return the mode that a seed names, {name: (..., n)} at local nodes. Collective.

    Its velocity is 1 at most. Raises `ParameterError` as `read_snapshot` does.
    """
    names = ("velocity", "pressure") + (("fluidity",) if form.grid.has_fluidity else ())
    return _read_fields(parameters, "seed", 0, form, names)[1]


def _read_fields(parameters, start, number, form, names):
    """Read the fields ``names`` of snapshot ``number`` of the file that ``start`` names."""
    path, lattice = getattr(parameters, start), form.grid.nodes

    def refuse(reason):
        raise ParameterError(start, path, reason)

    try:
        with open_file(path, "r", form.grid.comm.tompi4py(), (start, PREFIX)) as file:
            found = sorted(file["snapshots"])
            if not -len(found) <= number < len(found):
                refuse(f"it holds {len(found)} snapshots, and snapshot {number} is asked for")
            group = file["snapshots"][found[number]]
            shape = group[names[0]].shape[:2]
            if shape != lattice.shape[::-1]:
                refuse(f"its {shape[1]} x {shape[0]} nodes are not the "
                       f"{lattice.shape[0]} x {lattice.shape[1]} of this grid")
            theirs = cases.read(written(file.attrs["options"]), stored=True)
            for row in parameters.rows:
                mine, other = (getattr(of, row.name, None) for of in (parameters, theirs))
                if start in row.shared and mine != other:
                    raise ParameterError(row.name, mine, f"{path} was made with {other}")
            nx, ny = lattice.shape
            j0, i0 = lattice.j.min(), lattice.i.min()
            # Ghosts of a periodic lattice lie beyond its ends.
            rows, columns = (np.arange(low, index.max() + 1) % n for low, index, n in (
                (j0, lattice.j, ny), (i0, lattice.i, nx)))
            slab = tuple(slice(index.min(), index.max() + 1) for index in (rows, columns))
            inside = np.ix_(rows - rows.min(), columns - columns.min())
            fields = {name: np.moveaxis(group[name][slab][inside], (0, 1), (-2, -1)).reshape(
                group[name].shape[2:] + (-1,)) for name in names}
            return dict(group.attrs), fields
    except (OSError, KeyError) as problem:
        refuse(f"cannot be read ({problem})")
