"""A result as arrays: what a run wrote, and what follows from it; numpy and h5py only.

`pgran.open` returns a `Result`: ``result.options``, ``result.history`` and ``result.snapshots``. A
snapshot gives fields on the Q2 nodes by name, those of the file and those of `QUANTITIES`, and a
pyvista grid of Q2 elements.
"""

import os
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .. import cases
from ..material.elasticity import strain_fields
from ..options import PREFIX, ParameterError
from ..space.element import GAUSS_TO_NODES, NODES, Geometry
from . import band
from .reader import ResultError, field_of, opened, stored_parameters
from .snapshots import linked

#: Stands for the identifier of any run.
ANY = object()
#: Order of the nodes of VTK's biquadratic quadrilateral, as places among those of an element.
VTK_NODES = 0, 2, 8, 6, 1, 5, 7, 3, 4


class DerivedField(NamedTuple):
    """A field that a snapshot can give.

    ``symbol`` is for labels, in the mathematical notation of matplotlib; ``unit`` may name the
    stress unit of the case; ``of(snapshot)`` computes it, (ny, nx).
    """

    symbol: str
    unit: str
    meaning: str
    of: object


def _stored(name):
    return lambda snapshot: snapshot.stored(name)


def _part(name, place):
    return lambda snapshot: snapshot.stored(name)[..., place]


def _stress(place, pressure):
    return lambda snapshot: (snapshot.stored("deviator")[..., place]
                             - pressure * snapshot.stored("pressure"))


def _speed(snapshot):
    return np.hypot(*np.moveaxis(snapshot.stored("velocity"), -1, 0))


def _strain_rate(snapshot):
    d11, d22, d12 = np.moveaxis(snapshot.strain_field("strain_rate_tensor"), -1, 0)
    return np.sqrt(2.0 * (d11**2 + d22**2) + 4.0 * d12**2)


def _strain(snapshot):
    """ln(l1/l2), the difference of the principal values of the logarithmic strain."""
    h11, h22, h12 = np.moveaxis(snapshot.strain_field("strain_tensor"), -1, 0)
    return np.hypot(h11 - h22, 2.0 * h12)


def _above_yield(snapshot):
    ratio = snapshot.result.case.law.yield_ratio
    if not ratio:
        raise ResultError(snapshot.result.path, f"its law {snapshot.result.parameters.law} has no "
                          "yield value; there is no above_yield")
    return snapshot.stored("stress_ratio") - ratio


#: All quantities by name.
QUANTITIES = {
    "inertial_number": DerivedField("I", "", "inertial number", _stored("inertial_number")),
    "fluidity": DerivedField("g", "gdot0", "fluidity", _stored("fluidity")),
    "pressure": DerivedField("P", "stress", "pressure", _stored("pressure")),
    "stress_ratio": DerivedField(r"\mu", "", "stress ratio tau/P", _stored("stress_ratio")),
    "above_yield": DerivedField(r"\mu - \mu_s", "", "distance to yield", _above_yield),
    "speed": DerivedField("|v|", "d gdot0", "size of the velocity", _speed),
    "velocity_1": DerivedField("v_1", "d gdot0", "velocity along x1", _part("velocity", 0)),
    "velocity_2": DerivedField("v_2", "d gdot0", "velocity along x2", _part("velocity", 1)),
    "strain_rate": DerivedField(r"\dot\gamma", "gdot0", "equivalent shear rate sqrt(2 D:D)",
                            _strain_rate),
    "spin": DerivedField(r"\omega", "gdot0", "spin (d v2/d x1 - d v1/d x2)/2",
                     lambda snapshot: snapshot.strain_field("spin")),
    "strain": DerivedField(r"\gamma", "", "equivalent shear strain since the start, ln(l1/l2) of the "
                       "principal stretches", _strain),
    "volume_change": DerivedField("J - 1", "", "change of volume since the start",
                              lambda snapshot: snapshot.strain_field("volume_change")),
    "stress_11": DerivedField(r"\sigma_{11}", "stress", "stress, tension positive", _stress(0, 1.0)),
    "stress_22": DerivedField(r"\sigma_{22}", "stress", "stress, tension positive", _stress(1, 1.0)),
    "stress_12": DerivedField(r"\sigma_{12}", "stress", "stress, tension positive", _stress(2, 0.0)),
}


class Result:
    """What a run wrote, read when it is made; snapshots are read when they are asked for.

    Parameters
    ----------
    path : str or Path
        The HDF5 file, which may still be written.
    run : str or None, optional
        The identifier of the run that the file must hold; any run unless given.

    Attributes
    ----------
    path : Path
        The absolute path of the file.
    run : str or None
        The identifier of the run. Files of release 0.1 have none.
    attributes : dict
        Root attributes: versions, scales, and what the run took if it has ended.
    parameters : pgran.options.Parameters
        The resolved options.
    options : dict
        The same, {name: value}, without the prefix.
    history : dict
        {name: ndarray (steps,)}, one entry for each accepted step.
    history_units : dict
        {name: str}, the units of the history; empty for a pure number.
    snapshots : list of Snapshot

    Raises
    ------
    ResultError
        If it is not a result of pgran. Reading a snapshot raises it also where the file holds
        another run by then.
    """

    def __init__(self, path, run=ANY):
        self.path, self.run = Path(os.path.abspath(path)), run  # the current directory may change
        with self.opened() as file:
            self.attributes = dict(file.attrs)
            self.run = self.attributes.get("run")
            self.parameters = stored_parameters(file)
            self.history = {name: data[...] for name, data in file.get("history", {}).items()}
            self.history_units = {name: str(data.attrs.get("unit", ""))
                                  for name, data in file.get("history", {}).items()}
            self.snapshots = [
                Snapshot(self, name, dict(file["snapshots"][name].attrs), target)
                for name, target in linked(file).items()]
        self.options = {row.name: getattr(self.parameters, row.name)
                        for row in self.parameters.options}

    def __getstate__(self):
        """Leave out the case, which is made again: it may hold functions."""
        return {name: value for name, value in vars(self).items() if name != "case"}

    @contextmanager
    def opened(self, only=None):
        """Open the file to read it, as a context; raises `ResultError` if it holds another run.

        ``only`` names the snapshot that will be read.
        """
        with opened(self.path, only=only) as file:
            if self.run is not ANY and file.attrs.get("run") != self.run:
                raise ResultError(self.path, "another run has replaced the run that was read from "
                                  "this file")
            yield file

    def __repr__(self):
        end = "complete" if self.complete else "not complete"
        return (f"<{self.path}: {self.parameters.case}, {self.parameters.model}, "
                f"{len(self.snapshots)} snapshots, {end}>")

    @property
    def complete(self):
        """Whether the run came to its end."""
        return bool(self.attributes.get("complete", False))

    @property
    def steady(self):
        """Whether a steady flow was computed, in pseudo-time; the time of its steps is the same."""
        time = self.history.get("time", ())
        return "steady_residual" in self.attributes or (len(time) > 1 and not np.ptp(time))

    def progress(self):
        """Return what the history is drawn against: a name, and values (steps,).

        This is what the case is counted by, or of a steady flow the number of the step.
        """
        if self.steady:
            return "step", np.arange(1, len(self.history["time"]) + 1)
        return self.case.progress_name, self.history[self.case.progress_name]

    @cached_property
    def case(self):
        """The `pgran.cases.Case` that was solved; raises `ResultError` where it is not found."""
        try:
            return cases.create(self.parameters)
        except ParameterError as problem:
            raise ResultError(self.path, f"its case cannot be made ({problem})") from None

    @property
    def closed(self):
        """Whether the last nodes along x1 and x2 neighbour the first ones."""
        return tuple(map(bool, self.attributes.get("closed", (False, False))))

    @cached_property
    def fixed_period(self):
        """The period (2, 2) of a fixed mesh along x1 and x2, d; zero where it is not known."""
        try:
            return np.zeros((2, 2)) if self.case.moving else self.case.period
        except ResultError:
            return np.zeros((2, 2))

    def unit(self, name):
        """Return the unit of a quantity of `QUANTITIES` or of another field, empty if it has none.

        Raises `ResultError` for a stress whose case is not found.
        """
        if name in QUANTITIES:
            unit = QUANTITIES[name].unit
            return self.case.stress_unit if unit == "stress" else unit
        with opened(self.path) as file:
            return next((str(group[name].attrs.get("unit", ""))
                         for group in file["snapshots"].values() if name in group), "")


class Snapshot:
    """The fields of one moment, on the Q2 nodes (ny, nx); x1 runs along the last axis.

    Attributes
    ----------
    result : Result
    name : str
        Of its group in the file.
    attributes : dict
        Such as ``time`` (1/gdot0) and ``label``.
    target : str or None
        The name of its file; None for a snapshot inside the result file.
    """

    def __init__(self, result, name, attributes, target=None):
        self.result, self.name, self.attributes = result, name, attributes
        self.target, self._read, self._periods = target, {}, {}

    def __repr__(self):
        return f"<snapshot {self.name} of {self.result.path}: {self.label}>"

    @property
    def time(self):
        """Time, 1/gdot0."""
        return float(self.attributes["time"])

    @property
    def label(self):
        """Where in the run it is, in words; a steady flow has no time."""
        if "steady_residual" in getattr(self.result, "attributes", ()):
            return "steady flow"
        return str(self.attributes.get("label", ""))

    def stored(self, name):
        """Return a field of the file, (ny, nx, ...); raises `ResultError` where there is none."""
        if name not in self._read:
            with self._opened() as file:
                self._read[name] = field_of(file, self.name, name)
        return self._read[name]

    @contextmanager
    def _opened(self):
        """Open the result, as a context; raises `ResultError` where it has another snapshot."""
        with self.result.opened(self.name) as file:
            if linked(file).get(self.name, "") != self.target:
                raise ResultError(self.result.path, f"snapshot {self.name} was replaced after it "
                                  "was read, as the run went on")
            yield file

    def keep(self, fields, periods=None):
        """Take fields, {name: (ny, nx, ...)}, and `period` values in place of those of the file."""
        self._read.update(fields)
        self._periods.update(periods or {})

    def period(self, name):
        """Return by how much a field of the file changes once around a periodic grid, (2, ...).

        The first entry is the change along x1, the second one along x2. It is zero where the grid
        is not periodic, and for fields without the attribute ``period``. Files of earlier releases
        have no such attribute: the period of a fixed mesh then comes from the case.
        """
        if name not in self._periods:
            with self._opened() as file:
                data = file["snapshots"][self.name].get(name)
                found = None if data is None else data.attrs.get("period")
            if found is None:
                found = self.result.fixed_period if name == "coordinates" else np.zeros(2)
            self._periods[name] = found
        return self._periods[name]

    @cached_property
    def open_ends(self):
        """Whether the grid is periodic without being closed in space, along x1 and x2."""
        return tuple(not closed and bool(np.any(shift)) for closed, shift in zip(
            self.result.closed, self.period("coordinates")))

    def continued(self, axes):
        """Return the snapshot with its first nodes repeated at the ends of periodic directions.

        Parameters
        ----------
        axes : tuple of bool
            Whether to repeat the first nodes along x1 and along x2. Coordinates and velocity there
            are those of the next period.
        """
        return _Continued(self, axes) if any(axes) else self

    @cached_property
    def whole(self):
        """The snapshot whose nodes reach to the ends of all periodic directions."""
        return self.continued(tuple(map(np.logical_or, self.result.closed, self.open_ends)))

    def __getitem__(self, name):
        """Return a quantity of `QUANTITIES`, or any other field of the file."""
        return QUANTITIES[name].of(self) if name in QUANTITIES else self.stored(name)

    @property
    def x(self):
        """Coordinates of the nodes, (ny, nx, 2), d."""
        return self.stored("coordinates")

    @cached_property
    def velocity_gradient(self):
        """(2, 2, ny, nx): d v_i/d x_j, gdot0, from the Gauss points."""
        return self._at_nodes(self._gradient(self.whole.stored("velocity"), self.whole.x))

    @cached_property
    def deformation_gradient(self):
        """(2, 2, ny, nx): d x_i/d X_j since the start, from the Gauss points.

        Raises `ResultError` on a fixed mesh.
        """
        return self._at_nodes(self._gradient(self.whole.x, self._start()))

    def strain_field(self, name):
        """Return one of `pgran.material.elasticity.strain_fields`, (ny, nx, ...).

        It is that of the file. Where the file lacks it, as those of earlier releases may, it is
        computed from velocity and coordinates in the way of
        `pgran.space.diagnostics.nodal_strains`.

        Raises
        ------
        ResultError
            For a strain since the start on a fixed mesh, and where the elements cannot be made.
        """
        if name in self._read or name in self.names:
            return self.stored(name)
        x, velocity, since_start = self.whole.x, self.whole.stored("velocity"), None
        if name in ("strain_tensor", "volume_change"):
            since_start = self._gradient(x, self._start())
        values = strain_fields(self._gradient(velocity, x), since_start)[name]
        found = self._at_nodes(values)
        return found if values.ndim == 2 else np.moveaxis(found, 0, -1)

    def _start(self):
        """The coordinates (ny, nx, 2) of the nodes of `whole` at the start, d."""
        case = self.result.case
        if not case.moving:
            raise ResultError(self.result.path, "its mesh does not move with the material; there "
                              "is no strain since the start")
        ny, nx = self.whole.x.shape[:2]
        j, i = (index.ravel() for index in np.mgrid[:ny, :nx])
        return np.moveaxis(case.coordinates(i, j).reshape(2, ny, nx), 0, -1)

    @cached_property
    def _elements(self):
        """The nodes (9, n) of the elements of `whole`, in the order of `pgran.space.element`."""
        shape = self.whole.x.shape[:2]
        if min(shape) < 3 or not all(n % 2 for n in shape):
            raise ResultError(self.result.path, f"its {shape[1]} x {shape[0]} nodes make no whole "
                              "elements: it lacks the period of its grid, which later releases "
                              "store")
        return np.array(q2_elements(shape)[:, np.argsort(VTK_NODES)].T)

    def _gradient(self, values, x):
        """Gradient (2, 2, points, n) of fields (ny, nx, 2) of `whole` on nodes ``x``."""
        values, x = (np.moveaxis(field, -1, 0).reshape(2, -1)[:, self._elements]
                     for field in (values, x))
        geometry = Geometry(x)
        return np.array([geometry.gradient(part) for part in values])

    def _at_nodes(self, values):
        """Means over elements (..., ny, nx) of values at the Gauss points, (..., points, n)."""
        ny, nx = self.x.shape[:2]
        j, i = np.divmod(self._elements, self.whole.x.shape[1])
        nodes = (j % ny * nx + i % nx).ravel()
        count = np.bincount(nodes, minlength=ny * nx)
        found = [np.bincount(nodes, (GAUSS_TO_NODES @ part).ravel(), ny * nx) / count
                 for part in values.reshape(-1, *values.shape[-2:])]
        return np.reshape(found, (*values.shape[:-2], ny, nx))

    def band(self):
        """Return what `pgran.output.band.band` measures, a dictionary."""
        return band.band(self.x, self["inertial_number"])

    def grid(self, *names):
        """Return a pyvista UnstructuredGrid of Q2 elements with quantities at the nodes.

        All fields of the file unless ``names`` are given. Vectors get a third component of zero. On
        a grid that is periodic without being closed in space, the first nodes are repeated at the
        end of the period.
        """
        import pyvista

        shown, shape = self.continued(self.open_ends), self.x.shape[:2]
        order = np.argsort(numbers(shape, self.open_ends).ravel())
        elements = q2_elements(shape, self.result.closed, self.open_ends)
        cells = np.hstack([np.full((len(elements), 1), NODES), elements])
        points = np.pad(shown.x.reshape(-1, 2)[order], ((0, 0), (0, 1)))
        grid = pyvista.UnstructuredGrid(
            cells.ravel(), np.full(len(cells), pyvista.CellType.BIQUADRATIC_QUAD), points)
        for name in names or self.names:
            flat = shown[name].reshape(len(points), -1)[order]
            grid[name] = flat.ravel() if flat.shape[1] == 1 else (
                np.pad(flat, ((0, 0), (0, 1))) if flat.shape[1] == 2 else flat)
        return grid

    @cached_property
    def names(self):
        """The fields of the file besides the coordinates, a tuple of names."""
        with self._opened() as file:
            return tuple(name for name in file["snapshots"][self.name] if name != "coordinates")


class _Continued(Snapshot):
    """A snapshot with its first nodes repeated, see `Snapshot.continued`."""

    def __init__(self, snapshot, axes):
        super().__init__(snapshot.result, snapshot.name, snapshot.attributes)
        self._of, self._axes, self.whole, self.open_ends = snapshot, axes, self, (False, False)

    def stored(self, name):
        """Return a field of the file, (ny, nx, ...), with the repeated nodes."""
        return self._extended(self._of.stored(name), self._of.period(name))

    def strain_field(self, name):
        """Return a field of `Snapshot.strain_field` with the repeated nodes."""
        return self._extended(self._of.strain_field(name), np.zeros(2))

    def _extended(self, field, period):
        for axis, wrap, shift in zip((1, 0), self._axes, period):
            if wrap:
                field = np.concatenate([field, np.take(field, [0], axis) + shift], axis)
        return field


def cells(shape, closed=(False, False)):
    """Return the nodes (n, 4) of the cells between ``shape`` = (ny, nx) nodes, counterclockwise.

    ``closed`` says whether the last nodes along x1 and along x2 neighbour the first ones.
    """
    ny, nx = shape
    wide, high = (n if wrap else n - 1 for n, wrap in zip((nx, ny), closed))
    j, i = (index.ravel() for index in np.mgrid[:high, :wide])
    across, up = (i + 1) % nx, (j + 1) % ny
    return np.stack([j * nx + i, j * nx + across, up * nx + across, up * nx + i], axis=1)


def q2_elements(shape, closed=(False, False), repeated=(False, False)):
    """Return the nodes (n, 9) of the Q2 elements on ``shape`` = (ny, nx) nodes, in VTK's order.

    Parameters
    ----------
    shape : tuple of int
    closed : tuple of bool
        Whether the last nodes along x1 and x2 neighbour the first ones.
    repeated : tuple of bool
        Whether the first nodes are repeated at the end along x1 and x2, on a grid that is periodic
        without being closed in space; otherwise its last elements have no end and are left out.
        The repeated nodes are numbered after all others, as `numbers` has it.
    """
    node = numbers(shape, repeated)
    ny, nx = node.shape
    wide, high = (n // 2 if wrap else (n - 1) // 2 for n, wrap in zip((nx, ny), closed))
    j, i = (2 * index.ravel() for index in np.mgrid[:high, :wide])
    nodes = np.stack([node[(j + up) % ny, (i + along) % nx]
                      for up in range(3) for along in range(3)], axis=1)
    return nodes[:, VTK_NODES]


def numbers(shape, repeated):
    """Return the numbers of ``shape`` = (ny, nx) nodes, row by row, and of repeated ones behind.

    An array with one more column where the first nodes are ``repeated`` along x1, and with one more
    row where they are along x2. These are numbered row by row too, after all others.
    """
    ny, nx = shape
    found = np.full((ny + int(repeated[1]), nx + int(repeated[0])), -1)
    found[:ny, :nx] = np.arange(ny * nx).reshape(shape)
    found[found < 0] = np.arange(ny * nx, found.size)
    return found


def options_of(values):
    """Return the words of a command line that give options, from {name: value}.

    A name is that of an option of pgran without its prefix; one that begins with a dash is given as
    it is, such as ``{"-snes_atol": 1e-6}``.
    """
    words = []
    for name, value in values.items():
        word = name if name.startswith("-") else f"-{PREFIX}{name}"
        if isinstance(value, (bool, np.bool_)):
            value = str(bool(value)).lower()
        elif isinstance(value, (list, tuple, np.ndarray)):
            value = ",".join(map(str, value))
        words += [word, str(value)]
    return words
