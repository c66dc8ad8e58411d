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

from . import __version__
from .options import OptionError, read, written
from .rheology import material_of

HISTORY = ("time", "compression", "top_stress", "step_size", "newton_iterations",
           "linear_iterations", "inertial_number_min", "inertial_number_max")
INTEGERS = ("newton_iterations", "linear_iterations")


class Writer:
    """Writes the results of a run on a grid. Every method is collective.

    An earlier file of the same name is kept: it is renamed with a number.
    Raises `OptionError` where the file cannot be made.
    """

    def __init__(self, path, grid, settings, attributes=None):
        self.path, self.grid = Path(path), grid
        self.comm = grid.comm.tompi4py()
        self.kept = self.root_only(self._make_room)
        self._history = {name: [] for name in HISTORY}
        self.snapshots = []
        with self._open("w") as file:
            file.attrs["options"] = settings.text()
            file.attrs["pgran_version"] = __version__
            file.attrs["petsc_version"] = ".".join(map(str, PETSc.Sys.getVersion()))
            for name, value in {**scales(settings), **(attributes or {})}.items():
                file.attrs[name] = value
            file.create_group("snapshots")
            history = file.create_group("history")
            for name in HISTORY:
                history.create_dataset(name, shape=(0,), maxshape=(None,), chunks=(1024,),
                                       dtype="i8" if name in INTEGERS else "f8")

    def root_only(self, action):
        """Do ``action`` on rank 0; every rank gets its answer, or its `OptionError`."""
        answer = error = None
        if self.comm.rank == 0:
            try:
                answer = action()
            except OSError as problem:
                error = f"-pgran_output {self.path}: {problem.strerror or problem}"
        answer, error = self.comm.bcast((answer, error))
        if error:
            raise OptionError(error)
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
        return open_file(self.path, mode, self.comm, "output")

    def record(self, **values):
        """Add an accepted step to the history; `snapshot` and `flush` write it."""
        for name in HISTORY:
            self._history[name].append(values[name])

    def snapshot(self, time, compression, fields):
        """Write fields at the local nodes, {name: (..., n)}, 'coordinates' among them; and history.
        """
        lattice = self.grid.nodes
        shape = lattice.shape[::-1]
        block = (slice(lattice.j0, lattice.j1), slice(lattice.i0, lattice.i1))
        inner = lattice.j1 - lattice.j0, lattice.i1 - lattice.i0
        name = f"{len(self.snapshots):04d}"
        with self._open("a") as file:
            group = file["snapshots"].create_group(name)
            group.attrs["time"], group.attrs["compression"] = time, compression
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

    Raises `OptionError` where h5py cannot do so.
    """
    if comm.size == 1:
        return h5py.File(path, mode)
    if not h5py.get_config().mpi:
        raise OptionError(f"-pgran_{option} {path}: {comm.size} ranks need an h5py built with MPI")
    return h5py.File(path, mode, driver="mpio", comm=comm)


def scales(settings):
    """Return the SI scales as attributes, as far as the options give d, rho_s and sigma_1.

    Length d (m), stress |sigma_1| (Pa), and time 1/gdot0 = d sqrt(rho_s/|sigma_1|)
    / (I0 sqrt(P0)) (s) with P0 in |sigma_1|.
    """
    found = {}
    if settings.grain_diameter:
        found["scale_length"] = settings.grain_diameter
    if settings.lateral_stress:
        found["scale_stress"] = settings.lateral_stress
    if settings.grain_diameter and settings.lateral_stress and settings.grain_density:
        found["scale_time"] = (settings.grain_diameter
                               * np.sqrt(settings.grain_density / settings.lateral_stress)
                               / material_of(settings).root_density)
    return found


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


#: Options that a mode or a snapshot must share with the run that starts from it.
MODE_PHYSICS = ("case", "model", "law", "mu_s", "mu_2", "b", "A", "phi", "inertial_number", "width",
                "height")
PHYSICS = ("case", "model", "law", "mu_s", "mu_2", "b", "A", "inertial_number", "width", "height",
           "element_size", "imperfection", "imperfection_size", "imperfection_mirrored",
           "plates_slip", "body_force")


def read_snapshot(settings, lattice, comm):
    """Return the snapshot that ``-pgran_restart`` names: attributes, and {name: (..., n)}.

    The fields are those of `Writer.snapshot` at the local nodes of ``lattice``. Raises
    `OptionError` where the file, the snapshot, its grid or its physics does not fit.
    Collective.
    """
    return _read_fields(settings, "restart", settings.restart_snapshot, PHYSICS, lattice, comm,
                        ("coordinates", "velocity", "pressure", "fluidity", "deviator"))


def read_mode(settings, lattice, comm):
    """Return the mode that ``-pgran_seed`` names, {name: (..., n)} at local nodes. Collective.

    Its velocity is 1 at most. Raises `OptionError` as `read_snapshot` does.
    """
    names = ("velocity", "pressure") + (("fluidity",) if settings.model == "ngf" else ())
    return _read_fields(settings, "seed", 0, MODE_PHYSICS, lattice, comm, names)[1]


def _read_fields(settings, option, number, physics, lattice, comm, names):
    path = getattr(settings, option)
    try:
        with open_file(path, "r", comm, option) as file:
            found = sorted(file["snapshots"])
            if not -len(found) <= number < len(found):
                raise OptionError(f"-pgran_{option}_snapshot {number}: {path} holds {len(found)}")
            group = file["snapshots"][found[number]]
            shape = group[names[0]].shape[:2]
            if shape != lattice.shape[::-1]:
                raise OptionError(f"-pgran_{option} {path}: its {shape[1]} x {shape[0]} nodes are "
                                  f"not the {lattice.shape[0]} x {lattice.shape[1]} of this grid")
            theirs = read(written(file.attrs["options"]))
            for name in physics:
                if getattr(theirs, name) != getattr(settings, name):
                    raise OptionError(f"-pgran_{name} {getattr(settings, name)}: {path} was made "
                                      f"with {getattr(theirs, name)}")
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
        raise OptionError(f"-pgran_{option} {path}: cannot be read ({problem})") from None
