"""Writer of result files: HDF5 with the history and links to the snapshots.

The result file is replaced atomically after the file of a new snapshot is on the disk, so that a
run that is killed at any time leaves a valid result.
"""

import os
import sys
import uuid
from contextlib import closing, suppress
from itertools import islice
from pathlib import Path
from time import monotonic

import numpy as np
from petsc4py import PETSc

from .. import __version__
from ..kinematics import TENSORS
from ..options import PREFIX
from . import files, snapshots as snapshot_files, vtkhdf, xdmf
from .checkpoint import NAME, checkpoints_of
from .connectivity import cells
from .files import Disk, Draft
from .reader import FORMAT, opened
from .snapshots import GROUP, REPEATED
from .start import BASE

#: Columns of the history of a run in time: energies and volume, in the plane per unit depth.
BALANCE = "work", "dissipation", "stored_energy", "energy_error", "volume"
#: All columns of a run in time; a case adds its observables.
HISTORY = ("time", "step_size", "courant_number", "newton_iterations", "linear_iterations",
           "inertial_number_min", "inertial_number_max", *BALANCE)
INTEGERS = ("newton_iterations", "linear_iterations")
#: Units of fields and of columns of the history; "stress" is replaced by the stress unit of the
#: case and VOLUME by the unit of volume, and names that are missing are pure numbers.
UNITS = {"coordinates": "d", "displacement": "d", "velocity": "d gdot0", "speed": "d gdot0",
         "fluidity": "gdot0", "pressure": "stress", "deviator": "stress",
         "stress_tensor": "stress", "strain_rate_tensor": "gdot0", "spin": "gdot0",
         "time": "1/gdot0", "step_size": "1/gdot0", "work": "stress VOLUME",
         "dissipation": "stress VOLUME", "stored_energy": "stress VOLUME", "volume": "VOLUME"}
#: Units of root attributes, stored as the attributes NAME_unit.
ATTRIBUTE_UNITS = {"growth_rate": "gdot0", "steady_residual": "stress d", "begun": "s",
                   "seconds": "s", "memory": "MB", "scale_length": "m", "scale_stress": "Pa",
                   "scale_time": "s"}
#: Root attributes that describe the end of a run.
ENDING = {"state", "complete", "steady_residual", "steps", "steps_repeated", "newton_iterations",
          "linear_iterations", "seconds", "memory", "ranks"}
#: Root attribute: number of names of snapshot files that the run has used.
SERIAL = "snapshot_files"
#: Upper bounds of the size of the result file per snapshot and per node, bytes.
LINK, ELEMENT = 1000, 100
#: Maximum fraction of the run time for writing the history.
SHARE = 0.02
#: Values of the root attribute ``state``.
RUNNING, COMPLETE, STOPPED, FAILED = "running", "complete", "stopped", "failed"


class Writer:
    """Writer of the result of a run. Every method except `close` is collective.

    The constructor only locks the file; `begin` creates it. A file that cannot be written, or that
    another run writes, raises `ParameterError`. ``option`` = (name, prefix) is the option that
    names the file, and the observables of the case follow the ``columns`` of the history.
    ``run`` is the identifier of the run, ``kept`` the new name of an earlier file, and
    ``snapshots`` is a list of tuples (name, time, file name).
    """

    def __init__(self, path, form, option=("output", PREFIX), columns=HISTORY):
        # A symbolic link is kept, and all files of the run are in the folder of its target.
        self.path = Path(os.path.realpath(path) if os.path.islink(path) else path)
        self.grid, self.case = form.grid, form.case
        self.comm, self._shape = self.grid.comm.tompi4py(), self.grid.nodes.shape[::-1]
        self.disk = Disk(self.comm, option[0], path, option[1])
        self._columns = {name: [] for name in (*columns, *self.case.observables)}
        self.snapshots, self._fields = [], None
        self._next_write, self._serial, self._root = 0.0, 0, {}  # on rank 0
        #: Along which of x1 and x2 the first nodes are repeated in VTKHDF.
        self._ends = tuple(wrap and not closed for wrap, closed in zip(
            self.grid.periodic, self.case.closed))
        self._lock = self.run = self.kept = None
        self.disk.do(self._claim)

    def _claim(self):
        if self.path.exists() and not self.path.is_file():
            raise OSError("it exists and is not a regular file")
        for pattern, kind in ((NAME, "checkpoint"), (snapshot_files.NAME, "snapshot")):
            if match := pattern.fullmatch(self.path.name):
                raise OSError(f"this is the name of a {kind} of {match[1]}.h5")
        self._made = files.make_parents(self.path)
        self._lock = files.Lock(self.path)

    @property
    def steps(self):
        """Number of steps in the history."""
        return len(self._columns["time"])

    def begin(self, source=None, **attributes):
        """Create the file with root ``attributes`` and the content of a `Source`, if given.

        An earlier file of this name is renamed with a number unless it is the source.
        """
        same = source is not None and self.disk.do(
            lambda: self.path.exists() and os.path.samefile(source.path, self.path))
        # A run that continues in its file keeps its identifier and thus its checkpoints.
        self.run = source.run if same else self.comm.bcast(uuid.uuid4().hex[:16])
        self.kept, self.snapshots, self._fields, self._columns = self.disk.do(
            lambda: self._create(source, same, attributes))

    def _create(self, source, same, attributes):
        # `close` may write them after an error.
        self.snapshots, self._fields = self._copy(source) if source else ([], None)
        kept = None if same else self._rename_earlier()
        self._set_root({
            "state": RUNNING, "process": files.process_identity(), "run": self.run,
            "format": FORMAT, "pgran_version": __version__,
            "closed": self.case.closed, "options": self.case.parameters.text(),
            "petsc_version": ".".join(map(str, PETSc.Sys.getVersion())),
            **self.case.scales(), **attributes})
        self._write_index(self.snapshots, self._fields)
        snapshot_files.remove_unlinked(self.path, self.run, [file for *_, file in self.snapshots])
        self.path.with_suffix(".xdmf").unlink(missing_ok=True)
        if self.snapshots:
            xdmf.add(self.path, self._shape, self.snapshots, self._fields, self.case.closed)
        return kept, self.snapshots, self._fields, self._columns

    def _copy(self, source):
        """Read history and root attributes of a `Source`; return its snapshots and common fields.

        Snapshots inside the source or in files of another run are copied into files of this run.
        """
        snapshots, fields = [], None
        with opened(source.path) as file:
            history, groups = file["history"], file["snapshots"]
            if len(groups) < source.snapshots or any(
                    name not in history or len(history[name]) < source.steps
                    for name in self._columns):
                raise OSError(f"{source.path} does not hold the {source.steps} steps and "
                              f"{source.snapshots} snapshots before the checkpoint")
            for name, column in self._columns.items():
                column.extend(history[name][:source.steps].tolist())
            self._root = {name: value for name, value in file.attrs.items()
                          if name.removesuffix("_unit") not in ENDING}
            used = snapshot_files.files_of(self.path, self.run)
            self._serial = max([int(self._root.get(SERIAL, 0)), *(n + 1 for n in used)])
            for name, target in islice(snapshot_files.linked(file).items(), source.snapshots):
                group = groups[name]
                if not target or self.run != source.run:
                    draft = self._snapshot_draft(sum(data.nbytes for data in group.values()))
                    target = draft.path.name
                    with draft:
                        file.copy(group, draft.file, GROUP)
                        if vtkhdf.open_ends(group, self.case.closed) != self._ends:
                            self._ends = False, False  # format 3 has no periods
                        vtkhdf.repeat(group, draft.file, REPEATED, self._ends)
                    draft.publish(flush=True)
                snapshots.append((name, float(group.attrs["time"]), target))
                fields = common_fields(fields, {
                    key: data.shape[2:] for key, data in group.items()})
        return snapshots, fields

    def _snapshot_draft(self, size):
        path = snapshot_files.file_name(self.path, self.run, self._serial)
        self._serial += 1
        draft = Draft(path, size)
        with draft:
            draft.file.attrs.update({"file": path.name, "run": self.run, "format": FORMAT})
        return draft

    def _set_root(self, attributes):
        """Set root attributes, {name: value}, and their units."""
        self._root.update(attributes)
        self._root.update({f"{name}_unit": unit.replace("stress", self.case.stress_unit)
                           for name, unit in ATTRIBUTE_UNITS.items() if name in attributes})

    def _write_index(self, snapshots, fields, flush=True):
        """Write the result file, with links to the snapshot files."""
        draft = Draft(self.path, 8 * len(self._columns) * self.steps + LINK * len(snapshots)
                      + ELEMENT * int(np.prod(self._shape)))
        with draft:
            file = draft.file
            file.attrs.update({**self._root, SERIAL: self._serial})
            history = file.create_group("history")
            for name, values in self._columns.items():
                history[name] = np.array(values, "i8" if name in INTEGERS else "f8")
                history[name].attrs["unit"] = self._unit(name)
            file.create_group("snapshots", track_order=True)
            for name, _, target in snapshots:
                snapshot_files.add_link(file, name, target, self._ends)
            file.create_dataset("cells", data=cells(self._shape, self.case.closed), shuffle=True,
                                compression="gzip")
            if snapshots:
                vtkhdf.write(file, [time for _, time, _ in snapshots], self._shape, fields,
                             self.case.closed, self._ends)
        draft.publish(flush)

    def _unit(self, name):
        units = {**UNITS, **self.case.observables} if isinstance(
            self.case.observables, dict) else UNITS
        unit = units.get(name.removeprefix(BASE), "")
        return unit.replace("stress", self.case.stress_unit).replace(
            "VOLUME", self.grid.kinematics.volume_unit)

    def _rename_earlier(self):
        """Rename an earlier file, its XDMF and its checkpoints; return the new name."""
        if not self.path.exists():
            return None
        number = 1
        while (kept := self.path.with_suffix(f".{number}{self.path.suffix}")).exists():
            number += 1
        self.path.rename(kept)
        xdmf.rename(self.path, kept)
        for checkpoint in checkpoints_of(self.path):
            checkpoint.rename(kept.with_name(kept.stem + checkpoint.name[len(self.path.stem):]))
        return str(kept)

    def record(self, **values):
        """Add an accepted step to the history, which is written once `SHARE` allows it."""
        for name, column in self._columns.items():
            column.append(values[name])
        self.disk.do(self._record)

    def _record(self):
        begin = monotonic()
        if begin >= self._next_write:
            self._rewrite(flush=False)
            end = monotonic()
            self._next_write = end + (end - begin) / SHARE

    def _rewrite(self, flush=True, **attributes):
        """Write the history and root attributes, on rank 0."""
        self._check_present()
        self._set_root(attributes)
        self._write_index(self.snapshots, self._fields, flush)

    def _check_present(self):
        if not self.path.is_file():
            raise OSError("it was removed while the run wrote it")

    def snapshot(self, time, fields):
        """Write the history and the fields at the local nodes, {name: (..., n)}.

        One of the fields is ``coordinates``. NaN and infinite values are written, with a warning.
        """
        name = f"{len(self.snapshots):04d}"
        components = {key: value.shape[:-1] for key, value in fields.items()}
        periods = {key: self.grid.period(fields[key]) for key in ("coordinates", "velocity")
                   if key in fields and any(self.grid.periodic)}

        def prepare():
            self._check_present()
            draft = self._snapshot_draft(
                8 * sum(int(np.prod(self._shape + size)) for size in components.values()))
            with draft:
                group = draft.file.create_group(GROUP)
                group.attrs["time"], group.attrs["label"] = time, self.case.label(time)
                group.attrs[self.case.progress_name] = self.case.progress(time)
                for key, size in components.items():
                    data = group.create_dataset(key, self._shape + size, dtype="f8")
                    data.attrs["unit"] = self._unit(key)
                    if key in TENSORS:
                        data.attrs["components"] = self.grid.kinematics.labels
                    if key in periods:
                        data.attrs["period"] = periods[key]
            return draft

        def finish(draft):
            with draft:
                vtkhdf.repeat(draft.file[GROUP], draft.file, REPEATED, self._ends)
            draft.publish(flush=True)
            snapshots = [*self.snapshots, (name, time, draft.path.name)]
            self._write_index(snapshots, common)
            xdmf.add(self.path, self._shape, snapshots, common, self.case.closed)
            return snapshots

        common = common_fields(self._fields, components)
        self._warn_not_finite(name, fields)
        data = files.blocks_of(self.grid.nodes, fields, f"{GROUP}/")
        self.snapshots = files.write_draft(self.disk, prepare, data, finish)
        self._fields = common

    def _warn_not_finite(self, snapshot, fields):
        owned = self.grid.nodes.owned
        for name, values in fields.items():
            wrong = owned[~np.isfinite(values[..., owned]).reshape(-1, owned.size).all(axis=0)]
            points = sum(self.comm.allgather(fields["coordinates"][:, wrong].T.tolist()), [])
            if points and self.comm.rank == 0:
                x = ", ".join(f"{value:.4g}" for value in points[0])
                print(f"pgran: warning: {self.path}, snapshot {snapshot}: {name} is NaN or "
                      f"infinite at {len(points)} nodes, the first at x = ({x}) d",
                      file=sys.stderr, flush=True)

    def flush(self, **attributes):
        """Write the history, and root attributes."""
        self.disk.do(lambda: self._rewrite(**attributes))

    def close(self):
        """Release the file; a run without a final state has failed. Not collective."""
        if not self._lock:
            return
        if self._root.get("state") == RUNNING:
            with suppress(*files.FILE_ERRORS):  # for example if the disk is full
                self._rewrite(state=FAILED)
        with suppress(OSError):  # the folder may be missing
            self._lock.release()
            for folder in self._made:
                if not any(folder.iterdir()):
                    folder.rmdir()


def common_fields(known, components):
    """Return the fields except ``coordinates`` with one shape in ``known`` and in a snapshot.

    Both are {name: shape of its components}; None accepts all fields of the snapshot.
    """
    return {name: size for name, size in components.items()
            if name != "coordinates" and (known is None or known.get(name) == size)}


def write_once(path, form, fields, option=("output", PREFIX), **attributes):
    """Write a result with one snapshot at time 0 and root ``attributes``; return its `Writer`."""
    with closing(Writer(path, form, option)) as writer:
        writer.begin(**attributes)
        writer.snapshot(0.0, fields)
        writer.flush(state=COMPLETE)
    return writer
