"""Result files: HDF5 with snapshots and history, and XDMF beside it.

``/snapshots/NNNN`` holds fields on the grid of Q2 nodes (row = x2 index),
``/history`` one entry for each accepted step, the root attributes the resolved
options, the versions and the scales. ``/cells`` holds the nodes of the cells for XDMF. The file is
closed after each writing, so a run that stops later loses nothing that was written.
"""

import os
import sys
import uuid
from contextlib import suppress
from pathlib import Path
from time import monotonic
from xml.sax.saxutils import quoteattr

import h5py
import numpy as np
from petsc4py import PETSc

from .. import __version__
from ..options import PREFIX, ParameterError
from ..space.element import DIM
from .checkpoint import NAME, checkpoints_of
from .files import Disk, Draft, Lock, blocks_of, local_part, together, write_blocks, write_text
from .reading import FIELDS, FORMAT, ResultError, opened, stored_parameters
from .result import cells
from .vtkhdf import link

#: Columns of the history of a run in time: energies (stress d^2) and volume (d^2), per unit depth.
BALANCE = "work", "dissipation", "stored_energy", "energy_error", "volume"
#: All columns that a run in time has; a case adds its observables.
HISTORY = ("time", "step_size", "courant_number", "newton_iterations", "linear_iterations",
           "inertial_number_min", "inertial_number_max", *BALANCE)
INTEGERS = ("newton_iterations", "linear_iterations")
#: Units of fields and of columns of the history, where stress is that of the case; what is not
#: here is a pure number.
UNITS = {"coordinates": "d", "displacement": "d", "velocity": "d gdot0", "speed": "d gdot0",
         "fluidity": "gdot0", "pressure": "stress", "deviator": "stress",
         "stress_tensor": "stress", "strain_rate_tensor": "gdot0", "spin": "gdot0",
         "time": "1/gdot0", "step_size": "1/gdot0", "work": "stress d^2",
         "dissipation": "stress d^2", "stored_energy": "stress d^2", "volume": "d^2"}
#: Units of root attributes, which have them in a second attribute, NAME_unit.
ATTRIBUTE_UNITS = {"growth_rate": "gdot0", "steady_residual": "stress d", "begun": "s",
                   "seconds": "s", "memory": "MB", "scale_length": "m", "scale_stress": "Pa",
                   "scale_time": "s"}
#: What the names of the fields of the flow begin with that a mode was found about.
BASE = "base_"
#: Largest share of the time that writing the history takes.
SHARE = 0.02
#: Root attributes that say how a run ended.
ENDING = {"complete", "steady_residual", "steps", "steps_repeated", "newton_iterations",
          "linear_iterations", "seconds", "memory", "ranks"}


class Writer:
    """Writes the results of a run. Every method but `close` is collective.

    Making one only takes the right to write the file; `begin` makes the file. An earlier file of
    the same name is kept: it and its checkpoints are renamed with a number.

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
    columns : tuple of str
        Columns of the history besides the observables of the case.

    Attributes
    ----------
    kept : str or None
        The new name of an earlier file.
    run : str
        What names the run in its result and in its checkpoints.

    Raises
    ------
    ParameterError
        If the file cannot be made, or if another run writes it.
    """

    def __init__(self, path, form, attributes=None, option=("output", PREFIX),
                 columns=HISTORY):
        self.path, self.grid, self.case = Path(path), form.grid, form.case
        self.comm = self.grid.comm.tompi4py()
        self.disk = Disk(self.comm, option[0], path, option[1])
        self._attributes, self.kept = dict(attributes or {}), None
        self._columns = {name: [] for name in (*columns, *self.case.observables)}
        self.snapshots, self._fields, self._free_from = [], {}, 0.0
        self._lock = self._draft = self.run = None
        self.disk.do(self._claim)

    # Making the file

    def _claim(self):
        """Check that the file can be written, and take the right to do so."""
        if self.path.exists() and not self.path.is_file():
            raise OSError("it exists and is not a regular file")
        if match := NAME.fullmatch(self.path.name):
            raise OSError(f"this is the name of a checkpoint of {match[1]}.h5")
        self._made = [folder for folder in self.path.parents if not folder.exists()]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._lock = Lock(self.path)

    @property
    def begun(self):
        """Whether `begin` was called."""
        return self.run is not None

    @property
    def steps(self):
        """How many steps the history holds."""
        return len(self._columns["time"])

    def begin(self, source=None, **attributes):
        """Make the file, with root ``attributes`` besides those that were given.

        With a `Source` the file begins with what that holds. If it is the file itself, nothing is
        renamed.
        """
        self._attributes.update(attributes)
        same = source is not None and self.disk.do(
            lambda: self.path.exists() and os.path.samefile(source.path, self.path))
        # A run that goes on in its file is the same one: its checkpoints hold until there are new.
        self.run = source.run if same else self.comm.bcast(uuid.uuid4().hex)
        self.kept, self.snapshots, self._fields, self._columns = self.disk.do(
            lambda: self._make(source, same))
        if self.snapshots:
            self._write_xdmf()

    def _make(self, source, same):
        attributes = {
            "run": self.run, "format": FORMAT, "closed": self.case.closed,
            "options": self.case.parameters.text(),
            "pgran_version": __version__,
            "petsc_version": ".".join(map(str, PETSc.Sys.getVersion())),
            **self.case.scales(), **self._attributes}
        snapshots, fields = [], {}
        draft = Draft(self.path, 0, source.path if source else None)
        try:
            file = draft.file
            for group in ("snapshots", "history"):
                file.require_group(group)
            if source:
                snapshots, fields = source.cut(file, self._columns)
            for name in self._columns:
                if name not in file["history"]:
                    file["history"].create_dataset(
                        name, shape=(0,), maxshape=(None,), chunks=(1024,),
                        dtype="i8" if name in INTEGERS else "f8")
                file["history"][name].attrs["unit"] = self._unit(name)
            link(file, self.case.closed)
            self._set_attributes(file, attributes)
            if "cells" not in file:
                file["cells"] = cells(self.grid.nodes.shape[::-1], self.case.closed)
            kept = None if same else self._make_room()
        except BaseException:
            draft.drop()
            raise
        draft.publish(flush=True)
        if not snapshots:
            self.path.with_suffix(".xdmf").unlink(missing_ok=True)
        return kept, snapshots, fields, self._columns

    def _unit(self, name):
        """The unit of a field or of a column of the history, empty for a pure number."""
        own = self.case.observables
        unit = own.get(name, "") if isinstance(own, dict) and name in own else UNITS.get(
            name.removeprefix(BASE), "")
        return unit.replace("stress", self.case.stress_unit)

    def _set_attributes(self, file, attributes):
        """Set root attributes, {name: value}, with their units."""
        for name, value in attributes.items():
            file.attrs[name] = value
            if name in ATTRIBUTE_UNITS:
                file.attrs[f"{name}_unit"] = ATTRIBUTE_UNITS[name].replace(
                    "stress", self.case.stress_unit)

    def _make_room(self):
        """Rename an earlier file, its XDMF and its checkpoints; return the new name."""
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
        for checkpoint in checkpoints_of(self.path):
            checkpoint.rename(kept.with_name(kept.stem + checkpoint.name[len(self.path.stem):]))
        return str(kept)

    # Adding to it

    def record(self, **values):
        """Add an accepted step to the history.

        The file has it at once, unless that took more than `SHARE` of the time since: then it has
        it with one of the next steps.
        """
        for name, column in self._columns.items():
            column.append(values[name])
        self.disk.do(self._record)

    def _record(self):
        begin = monotonic()
        if begin < self._free_from:
            return
        self._rewrite(flush=False)
        end = monotonic()
        self._free_from = end + (end - begin) / SHARE

    def _rewrite(self, flush=True, **attributes):
        """Write the history and root attributes, on rank 0."""
        self._open_draft(0)
        self._publish(flush, attributes)

    def _open_draft(self, room):
        if not self.path.is_file():
            raise OSError("it was removed while the run wrote it")
        self._draft = Draft(self.path, room + 8 * sum(map(len, self._columns.values())), self.path)

    def _publish(self, flush, attributes, linked=False):
        draft, self._draft = self._draft, None
        try:
            for name, values in self._columns.items():
                data = draft.file["history"][name]
                if data.shape[0] < len(values):
                    done = data.shape[0]
                    data.resize((len(values),))
                    data[done:] = values[done:]
            self._set_attributes(draft.file, attributes)
            if linked:
                link(draft.file, self.case.closed)
        except BaseException:
            draft.drop()
            raise
        draft.publish(flush)

    def snapshot(self, time, fields):
        """Write the history, and fields at the local nodes, {name: (..., n)}.

        One of the fields is ``coordinates``. What is not a number is written as it is, and told on
        standard error.
        """
        lattice = self.grid.nodes
        shape = lattice.shape[::-1]
        name = f"{len(self.snapshots):04d}"
        components = {key: value.shape[:-1] for key, value in fields.items()}
        periods = {key: self.grid.period(fields[key]) for key in ("coordinates", "velocity")
                   if key in fields and any(self.grid.periodic)}

        def prepare():
            self._open_draft(8 * sum(int(np.prod(shape + size)) for size in components.values()))
            group = self._draft.file["snapshots"].create_group(name)
            group.attrs["time"], group.attrs["label"] = time, self.case.label(time)
            group.attrs[self.case.counted_by] = self.case.count(time)
            for key, size in components.items():
                data = group.create_dataset(key, shape + size, dtype="f8")
                data.attrs["unit"] = self._unit(key)
                if key in periods:
                    data.attrs["period"] = periods[key]

        self.disk.do(prepare)
        self._tell_meaningless(name, fields)
        group = None if self.comm.rank else self._draft.file["snapshots"][name]
        problem = write_blocks(self.comm, group, blocks_of(lattice, fields))
        if problem:
            draft, self._draft = self._draft, None
            draft.drop()
        self.disk.agree(None, problem)
        self.disk.do(lambda: self._publish(True, {}, linked=True))
        self._fields = {key: size for key, size in components.items()
                        if key != "coordinates" and (not self.snapshots or key in self._fields)}
        self.snapshots.append((name, time))
        self._write_xdmf()

    def _tell_meaningless(self, snapshot, fields):
        """Say which fields of a snapshot are not numbers everywhere, and where."""
        owned = self.grid.nodes.owned
        for name, values in fields.items():
            wrong = owned[~np.isfinite(values[..., owned]).reshape(-1, owned.size).all(axis=0)]
            places = [x for found in self.comm.allgather(fields["coordinates"][:, wrong].T.tolist())
                      for x in found]
            if places and self.comm.rank == 0:
                at = ", ".join(f"{part:.4g}" for part in places[0])
                print(f"pgran: warning: {self.path}, snapshot {snapshot}: {name} is not a number "
                      f"at {len(places)} nodes, the first at x = ({at}) d", file=sys.stderr,
                      flush=True)

    def _write_xdmf(self):
        self.disk.do(lambda: write_xdmf(self.path, self.grid.nodes.shape[::-1], self.snapshots,
                                        self._fields, self.case.closed))

    def flush(self, **attributes):
        """Write the history, and root attributes."""
        self.disk.do(lambda: self._rewrite(**attributes))

    def close(self):
        """Let others write the file. Not collective, as it may follow an error of one rank."""
        if not self._lock:
            return
        with suppress(OSError):  # the folder may be gone
            self._lock.release()
            for folder in self._made:
                if not any(folder.iterdir()):
                    folder.rmdir()


def write_once(path, form, fields, option=("output", PREFIX), **attributes):
    """Write a result of one snapshot at time 0, and return its `Writer`. Collective.

    ``option`` and ``attributes`` are those of a `Writer`, ``fields`` those of `Writer.snapshot`.
    """
    writer = Writer(path, form, attributes, option)
    try:
        writer.begin()
        writer.snapshot(0.0, fields)
    finally:
        writer.close()
    return writer


class Source:
    """The part of a result that a run goes on from: what it held at a checkpoint.

    Parameters
    ----------
    path : str or Path
        The result file.
    run : str
        What names the run in its result and in its checkpoints.
    steps, snapshots : int
        Entries of the history, and snapshots, that it held.
    """

    def __init__(self, path, run, steps, snapshots):
        self.path, self.run, self.steps, self.snapshots = Path(path), run, steps, snapshots

    def cut(self, file, columns):
        """Take from an open copy what came later; add its history to ``columns``, {name: list}.

        Returns the snapshots, pairs of name and time, and the shapes of the components of their
        fields, {name: tuple}. Raises OSError where the file holds less than it should.
        """
        history, groups = file["history"], file["snapshots"]
        if len(groups) < self.snapshots or any(
                name not in history or len(history[name]) < self.steps for name in columns):
            raise OSError(f"{self.path} does not hold the {self.steps} steps and {self.snapshots} "
                          "snapshots that lie before the checkpoint")
        for name, column in columns.items():
            history[name].resize((self.steps,))
            column.extend(history[name][...].tolist())
        names = sorted(groups)
        for name in names[self.snapshots:]:
            del groups[name]
        for name in set(file.attrs) & (ENDING | {f"{name}_unit" for name in ENDING}):
            del file.attrs[name]
        kept = names[:self.snapshots]
        fields = {key: data.shape[2:] for key, data in groups[kept[0]].items() if
                  key != "coordinates" and all(key in groups[name] for name in kept)
                  } if kept else {}
        return [(name, float(groups[name].attrs["time"])) for name in kept], fields


def write_xdmf(path, shape, snapshots, fields, closed=(False, False)):
    """Write NAME.xdmf, a time series of the snapshots, whole or not at all.

    Vectors get a third component of zero; tensors keep their components 11, 22 and 12.

    Parameters
    ----------
    path : str or Path
        The result file.
    shape : tuple of int
        Numbers of nodes (ny, nx).
    snapshots : list
        Pairs of the name of a group and the time.
    fields : dict
        {name: shape of its components}, besides the coordinates.
    closed : tuple of bool
        As `cells` has it.
    """
    path, count = Path(path), len(cells(shape, closed))
    topology = (f'<Topology TopologyType="Quadrilateral" NumberOfElements="{count}">'
                + xdmf_array(path.name, "/cells", (count, 4), "Int") + "</Topology>")
    lines = ['<?xml version="1.0"?>', '<Xdmf Version="2.0">', "<Domain>",
             '<Grid Name="pgran" GridType="Collection" CollectionType="Temporal">']
    for group, time in snapshots:
        x = xdmf_array(path.name, f"/snapshots/{group}/coordinates", (shape[0] * shape[1], DIM))
        lines += [f'<Grid Name="{group}" GridType="Uniform"><Time Value="{time:.16g}"/>',
                  topology, f'<Geometry GeometryType="XY">{x}</Geometry>']
        lines += [xdmf_field(name, path.name, f"/snapshots/{group}/{name}", shape, components)
                  for name, components in fields.items()]
        lines.append("</Grid>")
    lines += ["</Grid>", "</Domain>", "</Xdmf>"]
    write_text(path.with_suffix(".xdmf"), "\n".join(lines) + "\n")


def xdmf_array(file, dataset, shape, kind="Float"):
    """Return the XML of an array of ``shape``, the dataset (str) of an HDF5 ``file`` (str).

    VTK finds the dataset only in the file itself: it does not follow external links.
    """
    return (f'<DataItem Dimensions="{" ".join(map(str, shape))}" NumberType="{kind}" Precision="8" '
            f'Format="HDF">{quoteattr(f"{file}:{dataset}")[1:-1]}</DataItem>')


def xdmf_field(name, file, dataset, shape, components):
    """Return the XML of a nodal field of ``shape`` + ``components`` in a dataset of a file.

    VTK reads arrays of three components as they are. Those of two components are selected one after
    the other, and joined with zeros.
    """
    nodes, kind = shape[0] * shape[1], "Vector" if components else "Scalar"
    content = xdmf_array(file, dataset, (nodes, *components))
    if tuple(components) == (DIM,):
        array = xdmf_array(file, dataset, (*shape, DIM))
        slabs = "".join(
            f'<DataItem ItemType="HyperSlab" Dimensions="{nodes} 1"><DataItem Dimensions="3 3" '
            f'NumberType="Int" Format="XML">0 0 {place} 1 1 1 {shape[0]} {shape[1]} 1</DataItem>'
            f"{array}</DataItem>" for place in range(DIM))
        content = (f'<DataItem ItemType="Function" Dimensions="{nodes} 3" '
                   f'Function="JOIN($0, $1, 0*$0)">{slabs}</DataItem>')
    return f'<Attribute Name="{name}" AttributeType="{kind}" Center="Node">{content}</Attribute>'


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
    """Return the mode that a seed names, and the flow that it was found about. Collective.

    Both are {name: (..., n)} at local nodes. The velocity of the mode is 1 at most. The flow is
    empty where it is the reference flow. Raises `ParameterError` as `read_snapshot` does.
    """
    names = ("velocity", "pressure") + (("fluidity",) if form.grid.has_fluidity else ())
    base = tuple(BASE + name for name in (*names, "deviator"))
    _, fields = _read_fields(parameters, "seed", 0, form, names, base)
    return fields, {name[len(BASE):]: fields.pop(name) for name in base if name in fields}


def _read_fields(parameters, start, number, form, names, optional=()):
    """Read fields of a snapshot of the file that ``start`` names, ``optional`` ones if there."""
    path, lattice = getattr(parameters, start), form.grid.nodes

    def refuse(reason):
        raise ParameterError(start, path, reason)

    def read():
        with opened(path) as file:
            if start == "seed" and "growth_rate" not in file.attrs:
                refuse("it holds no mode, as pgran.eigen writes it")
            found = sorted(file["snapshots"])
            if not -len(found) <= number < len(found):
                refuse(f"it holds {len(found)} snapshots, and snapshot {number} is asked for")
            group = file["snapshots"][found[number]]
            wanted = (*names, *(name for name in optional if name in group))
            for name in wanted:
                size = FIELDS.get(name.removeprefix(BASE), ())
                data = group.get(name)
                if not isinstance(data, h5py.Dataset) or data.shape[2:] != size:
                    refuse(f"snapshot {found[number]} has no field {name} of {len(size) + 2} "
                           "dimensions")
                if data.shape[:2] != lattice.shape[::-1]:
                    refuse(f"its {data.shape[1]} x {data.shape[0]} nodes are not the "
                           f"{lattice.shape[0]} x {lattice.shape[1]} of this grid")
            theirs = stored_parameters(file)
            if start == "seed" and theirs.restart and not set(optional) <= set(wanted):
                refuse("its mode is one of a mesh that has moved; a run can begin with modes of "
                       "reference flows and of fixed meshes")
            for row in parameters.rows:
                mine, other = (getattr(of, row.name, None) for of in (parameters, theirs))
                if start in row.shared and mine != other:
                    raise ParameterError(row.name, mine, f"{path} was made with {other}")
            fields = {name: local_part(group[name], lattice.i, lattice.j) for name in wanted}
            for name, values in fields.items():
                if not np.isfinite(values).all():
                    refuse(f"its field {name} is not a number everywhere")
            return dict(group.attrs), fields

    def told_as_option():
        try:
            return read()
        except ResultError as problem:
            refuse(problem.reason)

    return together(form.grid.comm.tompi4py(), told_as_option)
