"""Result files: HDF5 with snapshots and history, and XDMF beside it.

``/snapshots/NNNN`` links to the fields on the grid of Q2 nodes (row = x2 index), each snapshot in
a file of its own (`pgran.output.snapshots`), ``/history`` holds one entry for each accepted step,
the root attributes the resolved options, the versions and the scales. ``/cells`` holds the nodes of
the cells for XDMF. The result file is replaced as a whole, after the file of a new snapshot is on
the disk: a run that is killed at any time leaves a good one.
"""

import os
import sys
import uuid
from contextlib import suppress
from pathlib import Path
from time import monotonic
from xml.sax.saxutils import escape

import h5py
import numpy as np
from petsc4py import PETSc

from .. import __version__
from ..options import PREFIX, ParameterError
from ..space.element import DIM
from . import vtkhdf
from .checkpoint import NAME, checkpoints_of
from .files import (
    Disk,
    Draft,
    Lock,
    blocks_of,
    local_part,
    make_parents,
    this_process,
    together,
    write_blocks,
    write_text,
)
from .reader import FIELDS, FORMAT, ResultError, opened, stored_parameters
from .result import cells
from .snapshots import (
    GROUP,
    NAME as SNAPSHOT_NAME,
    REPEATED,
    add_link,
    file_name,
    linked,
    next_serial,
    ordered,
    remove_unlinked,
)

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
#: Root attribute: how many names of snapshot files the run has used.
SERIAL = "snapshot_files"
#: Steps in one piece of a column of the history.
CHUNK = 128
#: Bytes that the result file needs at most for each snapshot, and for each node.
LINK, ELEMENT = 1000, 100
#: Largest share of the time that writing the history takes.
SHARE = 0.02
#: What NAME.xdmf begins and ends with.
XDMF_BEGIN = '''<?xml version="1.0"?>
<Xdmf Version="2.0">
<Domain>
<Grid Name="pgran" GridType="Collection" CollectionType="Temporal">
'''
XDMF_END = "</Grid>\n</Domain>\n</Xdmf>\n"
#: Values of the root attribute ``state``.
RUNNING, COMPLETE, STOPPED, FAILED = "running", "complete", "stopped", "failed"
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
        # A symbolic link stays one, and all files of the run lie beside its target.
        self.path = Path(os.path.realpath(path) if os.path.islink(path) else path)
        self.grid, self.case = form.grid, form.case
        self.comm = self.grid.comm.tompi4py()
        self.disk = Disk(self.comm, option[0], path, option[1])
        self._attributes, self.kept = dict(attributes or {}), None
        self._columns = {name: [] for name in (*columns, *self.case.observables)}
        self.snapshots, self._fields, self._free_from = [], None, 0.0
        self._files, self._serial, self._root = [], 0, {}  # on rank 0
        #: Along which of x1 and x2 the first nodes are repeated in VTKHDF.
        self._ends = tuple(wrap and not closed for wrap, closed in zip(
            self.grid.periodic, self.case.closed))
        self._lock = self.run = None
        self.disk.do(self._claim)

    # Making the file

    def _claim(self):
        """Check that the file can be written, and take the right to do so."""
        if self.path.exists() and not self.path.is_file():
            raise OSError("it exists and is not a regular file")
        for pattern, kind in ((NAME, "checkpoint"), (SNAPSHOT_NAME, "snapshot")):
            if match := pattern.fullmatch(self.path.name):
                raise OSError(f"this is the name of a {kind} of {match[1]}.h5")
        self._made = make_parents(self.path)
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
        self.run = source.run if same else self.comm.bcast(uuid.uuid4().hex[:16])
        self.kept, self.snapshots, self._fields, self._columns = self.disk.do(
            lambda: self._make(source, same))

    def _make(self, source, same):
        snapshots, fields = self._take_over(source) if source else ([], None)
        self._set_root({
            "state": RUNNING, "process": this_process(), "run": self.run, "format": FORMAT,
            "closed": self.case.closed,
            "options": self.case.parameters.text(),
            "pgran_version": __version__,
            "petsc_version": ".".join(map(str, PETSc.Sys.getVersion())),
            **self.case.scales(), **self._attributes})
        kept = None if same else self._make_room()
        self._write_index(snapshots, fields)
        remove_unlinked(self.path, self.run, self._files)
        self.path.with_suffix(".xdmf").unlink(missing_ok=True)
        if snapshots:
            self._write_xdmf(snapshots, fields)
        return kept, snapshots, fields, self._columns

    def _take_over(self, source):
        """Take what a `Source` holds, and return what `Source.read` does of its snapshots.

        Snapshots that lie in the source itself, or in files of another run, are copied into files
        of this run.
        """
        with opened(source.path) as file:
            snapshots, fields, self._root = source.read(file, self._columns)
            self._serial = max(next_serial(self.path, self.run), int(self._root.get(SERIAL, 0)))
            targets = linked(file)
            for name, _ in snapshots:
                target, group = targets[name], file["snapshots"][name]
                if target is None or self.run != source.run:
                    draft = self._snapshot_draft(sum(data.nbytes for data in group.values()))
                    target = draft.path.name
                    with draft:
                        file.copy(group, draft.file, GROUP)
                        if vtkhdf.open_ends(group, self.case.closed) == self._ends:
                            self._repeat_nodes(draft.file)
                        else:  # of an earlier release, without the period
                            self._ends = False, False
                    draft.publish(flush=True)
                elif REPEATED not in group.file:
                    self._ends = False, False
                self._files.append(target)
        return snapshots, fields

    def _snapshot_draft(self, room):
        """Return the `Draft` of the next snapshot file, for ``room`` bytes of fields."""
        path = file_name(self.path, self.run, self._serial)
        self._serial += 1
        draft = Draft(path, room)
        with draft:
            draft.file.attrs.update({"file": path.name, "run": self.run, "format": FORMAT})
        return draft

    def _repeat_nodes(self, file):
        """Write the repeated nodes of the snapshot in an open snapshot file."""
        if any(self._ends):
            vtkhdf.repeat(file[GROUP], file.create_group(REPEATED), self._ends)

    def _set_root(self, attributes):
        """Set root attributes, {name: value}, with their units; return those that were set."""
        units = {f"{name}_unit": ATTRIBUTE_UNITS[name].replace("stress", self.case.stress_unit)
                 for name in attributes if name in ATTRIBUTE_UNITS}
        self._root.update({**attributes, **units})
        return {**attributes, **units}

    def _write_index(self, snapshots, fields):
        """Write the result file: root attributes, history, and links to the snapshot files."""
        shape = self.grid.nodes.shape[::-1]
        draft = Draft(self.path, 8 * self._history_size() + LINK * len(snapshots)
                      + ELEMENT * int(np.prod(shape)))
        with draft:
            file = draft.file
            file.attrs.update({**self._root, SERIAL: self._serial})
            history = file.create_group("history")
            for name, values in self._columns.items():
                column = history.create_dataset(
                    name, data=np.array(values, "i8" if name in INTEGERS else "f8"),
                    maxshape=(None,), chunks=(CHUNK,))
                column.attrs["unit"] = self._unit(name)
            file.create_group("snapshots", track_order=True)
            for (name, _), target in zip(snapshots, self._files):
                add_link(file, name, target, self._ends)
            file.create_dataset("cells", data=cells(shape, self.case.closed), shuffle=True,
                                compression="gzip")
            if snapshots:
                vtkhdf.write(file, [time for _, time in snapshots], shape, fields,
                             self.case.closed, self._ends)
        draft.publish(flush=True)

    def _history_size(self):
        return sum(map(len, self._columns.values()))

    def _unit(self, name):
        """The unit of a field or of a column of the history, empty for a pure number."""
        own = self.case.observables
        unit = own.get(name, "") if isinstance(own, dict) and name in own else UNITS.get(
            name.removeprefix(BASE), "")
        return unit.replace("stress", self.case.stress_unit)

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
            text = xdmf.read_text().replace(f">{escape(self.path.name)}:/",
                                            f">{escape(kept.name)}:/")
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
        self._check_present()
        attributes = self._set_root(attributes)
        draft = Draft(self.path, 8 * self._history_size(), self.path)
        with draft:
            for name, values in self._columns.items():
                data = draft.file["history"][name]
                if data.shape[0] < len(values):
                    done = data.shape[0]
                    data.resize((len(values),))
                    data[done:] = values[done:]
            draft.file.attrs.update(attributes)
        draft.publish(flush)

    def _check_present(self):
        if not self.path.is_file():
            raise OSError("it was removed while the run wrote it")

    def snapshot(self, time, fields):
        """Write the history, and fields at the local nodes, {name: (..., n)}.

        One of the fields is ``coordinates``. The fields go into a file of their own, so that the
        cost does not depend on the number of snapshots. Values that are not finite are written as
        they are, with a warning on standard error.
        """
        lattice = self.grid.nodes
        shape = lattice.shape[::-1]
        name = f"{len(self.snapshots):04d}"
        components = {key: value.shape[:-1] for key, value in fields.items()}
        periods = {key: self.grid.period(fields[key]) for key in ("coordinates", "velocity")
                   if key in fields and any(self.grid.periodic)}
        draft = None

        def prepare():
            nonlocal draft
            self._check_present()
            draft = self._snapshot_draft(
                8 * sum(int(np.prod(shape + size)) for size in components.values()))
            with draft:
                group = draft.file.create_group(GROUP)
                group.attrs["time"], group.attrs["label"] = time, self.case.label(time)
                group.attrs[self.case.progress_name] = self.case.progress(time)
                for key, size in components.items():
                    data = group.create_dataset(key, shape + size, dtype="f8")
                    data.attrs["unit"] = self._unit(key)
                    if key in periods:
                        data.attrs["period"] = periods[key]

        self.disk.do(prepare)
        self._tell_meaningless(name, fields)
        group = None if self.comm.rank else draft.file[GROUP]
        problem = write_blocks(self.comm, group, blocks_of(lattice, fields))
        if problem:
            draft.drop()
        self.disk.agree(None, problem)
        self.snapshots.append((name, time))
        known = components if self._fields is None else self._fields
        self._fields = {key: size for key, size in components.items()
                        if key != "coordinates" and known.get(key) == size}

        def publish():
            with draft:
                self._repeat_nodes(draft.file)
            draft.publish(flush=True)
            self._files.append(draft.path.name)
            self._write_index(self.snapshots, self._fields)
            self._write_xdmf(self.snapshots, self._fields, add=True)

        self.disk.do(publish)

    def _write_xdmf(self, snapshots, fields, add=False):
        """Write NAME.xdmf, or only ``add`` the last snapshot to it."""
        entries = [(*snapshot, target) for snapshot, target in zip(snapshots, self._files)]
        (add_to_xdmf if add else write_xdmf)(
            self.path, self.grid.nodes.shape[::-1], entries, fields, self.case.closed)

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

    def flush(self, **attributes):
        """Write the history, and root attributes."""
        self.disk.do(lambda: self._rewrite(**attributes))

    def close(self):
        """Let others write the file. Not collective, as it may follow an error of one rank.

        A run that has not stored how it ended has failed.
        """
        if not self._lock:
            return
        if self._root.get("state") == RUNNING:
            with suppress(OSError, RuntimeError, KeyError, ValueError):  # as when the disk is full
                self._rewrite(state=FAILED)
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
        writer.flush(state=COMPLETE)
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

    def read(self, file, columns):
        """Read what an open result held at the checkpoint; its history goes into ``columns``.

        Returns
        -------
        snapshots : list of (str, float)
            Names and times.
        fields : dict or None
            {name: shape of its components} of the fields that all of them have; None without a
            snapshot.
        attributes : dict
            Root attributes, without those that say how the run ended.

        Raises
        ------
        OSError
            Where the file holds less than it should.
        """
        history, groups = file["history"], file["snapshots"]
        if len(groups) < self.snapshots or any(
                name not in history or len(history[name]) < self.steps for name in columns):
            raise OSError(f"{self.path} does not hold the {self.steps} steps and {self.snapshots} "
                          "snapshots that lie before the checkpoint")
        for name, column in columns.items():
            column.extend(history[name][:self.steps].tolist())
        attributes = {name: value for name, value in file.attrs.items()
                      if name.removesuffix("_unit") not in ENDING}
        snapshots, fields = [], None
        for name in ordered(groups)[:self.snapshots]:
            group = groups[name]
            snapshots.append((name, float(group.attrs["time"])))
            theirs = {key: data.shape[2:] for key, data in group.items() if key != "coordinates"}
            fields = theirs if fields is None else {
                key: size for key, size in fields.items() if theirs.get(key) == size}
        return snapshots, fields, attributes


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
        Triples of the name of a group, the time, and the name of the snapshot file.
    fields : dict
        {name: shape of its components}, besides the coordinates.
    closed : tuple of bool
        As `cells` has it.
    """
    path = Path(path)
    grids = "".join(_xdmf_grid(path, shape, *snapshot, fields, closed) for snapshot in snapshots)
    write_text(path.with_suffix(".xdmf"), XDMF_BEGIN + grids + XDMF_END)


def add_to_xdmf(path, shape, snapshots, fields, closed=(False, False)):
    """Add the last one of the snapshots to NAME.xdmf; parameters as for `write_xdmf`.

    Only this is written, in one piece, so that the cost does not depend on their number. A file
    that does not hold the earlier ones is written anew.
    """
    path = Path(path)
    text = _xdmf_grid(path, shape, *snapshots[-1], fields, closed) + XDMF_END
    try:
        with open(path.with_suffix(".xdmf"), "r+b", buffering=0) as file:
            end = file.seek(-len(XDMF_END), os.SEEK_END)
            if len(snapshots) > 1 and file.read() == XDMF_END.encode():
                file.seek(end)
                if file.write(text.encode()) == len(text.encode()):
                    return
    except FileNotFoundError:
        pass
    write_xdmf(path, shape, snapshots, fields, closed)


def _xdmf_grid(path, shape, group, time, target, fields, closed):
    """Return the element of XDMF of one snapshot."""
    count = len(cells(shape, closed))
    x = xdmf_array(target, f"/{GROUP}/coordinates", (shape[0] * shape[1], DIM))
    lines = [f'<Grid Name="{group}" GridType="Uniform"><Time Value="{time:.16g}"/>',
             f'<Topology TopologyType="Quadrilateral" NumberOfElements="{count}">'
             + xdmf_array(path.name, "/cells", (count, 4), "Int") + "</Topology>",
             f'<Geometry GeometryType="XY">{x}</Geometry>',
             *(xdmf_field(name, target, f"/{GROUP}/{name}", shape, components)
               for name, components in fields.items()),
             "</Grid>"]
    return "\n".join(lines) + "\n"


def xdmf_array(file, dataset, shape, kind="Float"):
    """Return the XML of an array of ``shape``, the dataset (str) of an HDF5 ``file`` (str).

    VTK finds the dataset only in the file itself: it does not follow external links.
    """
    return (f'<DataItem Dimensions="{" ".join(map(str, shape))}" NumberType="{kind}" Precision="8" '
            f'Format="HDF">{escape(f"{file}:{dataset}")}</DataItem>')


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
    _, fields = _read_fields(parameters, "mode_file", 0, form, names, base)
    return fields, {name[len(BASE):]: fields.pop(name) for name in base if name in fields}


def _read_fields(parameters, start, number, form, names, optional=()):
    """Read fields of a snapshot of the file that ``start`` names, ``optional`` ones if there."""
    path, lattice = getattr(parameters, start), form.grid.nodes

    def refuse(reason):
        raise ParameterError(start, path, reason)

    def read():
        with opened(path) as file:
            if start == "mode_file" and "growth_rate" not in file.attrs:
                refuse("it holds no mode, as pgran.eigen writes it")
            found = ordered(file["snapshots"])
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
            if start == "mode_file" and theirs.restart and not set(optional) <= set(wanted):
                refuse("its mode is one of a mesh that has moved; a run can begin with modes of "
                       "reference flows and of fixed meshes")
            for row in parameters.options:
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
