"""Results as arrays: options, history and fields of a result file; numpy and h5py only."""

import os
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .. import cases
from ..kinematics import SOLID, SWIRL
from ..material.elasticity import strain_fields
from ..options import PREFIX, ParameterError
from ..space.element import Geometry, element
from . import band
from .connectivity import QUADRATIC, q2_elements
from .reader import ResultError, field_of, opened, stored_parameters
from .snapshots import linked

#: Represents the identifier of any run.
ANY = object()


class DerivedField(NamedTuple):
    """A field (ny, nx) that a snapshot can give, computed by ``of(snapshot)``.

    ``symbol`` is in the mathematical notation of matplotlib. In ``unit``, "stress" is replaced by
    the stress unit of the case.
    """

    symbol: str
    unit: str
    meaning: str
    of: object


def _stored(name, component=slice(None)):
    return lambda snapshot: snapshot.stored(name)[..., component]


def _velocity(component):
    def of(snapshot):
        velocity = snapshot.stored("velocity")
        if component >= velocity.shape[-1]:
            raise ResultError(snapshot.result.path, f"its velocity has {velocity.shape[-1]} "
                              f"components; velocity_{component + 1} is undefined")
        return velocity[..., component]

    return of


def _angular_velocity(snapshot):
    if snapshot.kinematics is not SWIRL:
        raise ResultError(snapshot.result.path, "its flow does not turn about an axis; "
                          "angular_velocity is undefined")
    r, v = snapshot.x[..., 0], snapshot.stored("velocity")[..., 2]
    w = np.divide(v, r, out=np.zeros_like(v), where=r > 0.0)
    # On the axis the limit of an even function.
    return np.where(r > 0.0, w, (4.0 * w[:, 1:2] - w[:, 2:3]) / 3.0)


def _stress(label):
    def of(snapshot):
        labels = snapshot.kinematics.labels
        if label not in labels:
            raise ResultError(snapshot.result.path, f"its stress has the components "
                              f"{', '.join(labels)}; stress_{label} is undefined")
        m = labels.index(label)
        return (snapshot.stored("deviator")[..., m]
                - snapshot.kinematics.diagonal[m] * snapshot.stored("pressure"))

    return of


def _strain(name):
    return lambda snapshot: snapshot.strain_field(name)


def _strain_rate(snapshot):
    rate = np.moveaxis(snapshot.strain_field("strain_rate_tensor"), -1, 0)
    return np.sqrt(2.0 * (snapshot.kinematics.mandel(rate)**2).sum(axis=0))


def _shear_strain(snapshot):
    kinematics, strain = snapshot.kinematics, snapshot.strain_field("strain_tensor")
    matrix = kinematics.matrix(kinematics.mandel(np.moveaxis(strain, -1, 0)))
    return np.ptp(np.linalg.eigvalsh(np.moveaxis(matrix, (0, 1), (-2, -1))), axis=-1)


def _above_yield(snapshot):
    ratio = snapshot.result.case.law.yield_ratio
    if not ratio:
        raise ResultError(snapshot.result.path, f"its law {snapshot.result.parameters.law} has no "
                          "yield value; above_yield is undefined")
    return snapshot.stored("stress_ratio") - ratio


#: All quantities by name.
QUANTITIES = {name: DerivedField(*entry) for name, entry in {
    "inertial_number": ("I", "", "inertial number", _stored("inertial_number")),
    "fluidity": ("g", "gdot0", "fluidity", _stored("fluidity")),
    "pressure": ("P", "stress", "pressure", _stored("pressure")),
    "stress_ratio": (r"\mu", "", "stress ratio tau/P", _stored("stress_ratio")),
    "above_yield": (r"\mu - \mu_s", "", "distance to yield", _above_yield),
    "speed": ("|v|", "d gdot0", "size of the velocity",
              lambda snapshot: np.linalg.norm(snapshot.stored("velocity"), axis=-1)),
    **{f"velocity_{c + 1}": (f"v_{c + 1}", "d gdot0", f"velocity along x{c + 1}", _velocity(c))
       for c in range(3)},
    "angular_velocity": (r"\omega_z", "gdot0", "angular velocity v_t/r", _angular_velocity),
    "strain_rate": (r"\dot\gamma", "gdot0", "equivalent shear rate sqrt(2 D:D)", _strain_rate),
    "spin": (r"\omega", "gdot0", "spin (d v2/d x1 - d v1/d x2)/2", _strain("spin")),
    "strain": (r"\gamma", "", "equivalent shear strain since the start, ln(l1/l2) of the "
               "principal stretches", _shear_strain),
    "volume_change": ("J - 1", "", "change of volume since the start", _strain("volume_change")),
    **{f"stress_{label}": (rf"\sigma_{{{label}}}", "stress", "stress, tension positive",
                           _stress(label)) for label in (*SOLID.labels, *SWIRL.labels)},
}.items()}


class Result:
    """The result of a run, read by the constructor; fields are read on first use.

    Parameters
    ----------
    path : str or Path
        The HDF5 file. It may belong to a running job.
    run : str, optional
        The identifier of the run that the file must hold (default: any run).

    Attributes
    ----------
    path : Path
        Absolute.
    attributes : dict
        Root attributes: versions, scales, and the cost of a completed run.
    parameters : pgran.options.Parameters
        The resolved options; ``options`` is the same as {name: value}, without the prefix.
    history : dict
        {name: ndarray (steps,)}, one entry per accepted step; ``history_units`` = {name: str}.
    snapshots : list of Snapshot

    Raises
    ------
    ResultError
        If it is not a result file, or if another run replaces the file before a field is read.
    """

    def __init__(self, path, run=ANY):
        self.path, self.run = Path(os.path.abspath(path)), run  # the current directory may change
        with self.opened() as file:
            self.attributes = dict(file.attrs)
            self.run = self.attributes.get("run")
            self.parameters = stored_parameters(file)
            columns = file.get("history", {}).items()
            self.history = {name: data[...] for name, data in columns}
            self.history_units = {name: str(data.attrs.get("unit", "")) for name, data in columns}
            self.snapshots = [
                Snapshot(self, name, dict(file["snapshots"][name].attrs), target)
                for name, target in linked(file).items()]
        self.options = {option.name: getattr(self.parameters, option.name)
                        for option in self.parameters.options}

    def __getstate__(self):
        """Leave out the case, which may hold functions and is created again."""
        return {name: value for name, value in vars(self).items() if name != "case"}

    @contextmanager
    def opened(self, only=None):
        """Open the file as a context to read all snapshots or ``only`` one."""
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
        """Whether the run was completed."""
        return bool(self.attributes.get("complete"))

    @property
    def steady(self):
        """Whether it is a steady flow, computed in pseudo-time: all steps have the same time."""
        time = self.history.get("time", ())
        return "steady_residual" in self.attributes or (len(time) > 1 and not np.ptp(time))

    def progress(self):
        """Return name and values (steps,) of the progress, for a steady flow the step numbers."""
        if self.steady:
            return "step", np.arange(1, len(self.history["time"]) + 1)
        return self.case.progress_name, self.history[self.case.progress_name]

    @cached_property
    def case(self):
        """The `pgran.cases.Case` of the run; raises `ResultError` if it cannot be created."""
        try:
            return cases.create(self.parameters)
        except ParameterError as problem:
            raise ResultError(self.path, f"its case cannot be created ({problem})") from None

    @property
    def closed(self):
        """Whether the last nodes along x1 and x2 are neighbours of the first ones in space."""
        return tuple(map(bool, self.attributes.get("closed", (False, False))))

    def unit(self, name):
        """Return the unit of a field; empty for a pure number."""
        if name in QUANTITIES:
            unit = QUANTITIES[name].unit
            return self.case.stress_unit if unit == "stress" else unit
        with opened(self.path) as file:
            return next((str(group[name].attrs.get("unit", ""))
                         for group in file["snapshots"].values() if name in group), "")


class Snapshot:
    """The fields at one time, on the Q2 nodes (ny, nx); x1 varies along the last axis.

    Attributes
    ----------
    result : Result
    name : str
        The name of its group in the file.
    attributes : dict
        For example ``time`` (1/gdot0) and ``label``.
    target : str or None
        The name of its file; None inside the result file.
    """

    def __init__(self, result, name, attributes, target=None):
        self.result, self.name, self.attributes = result, name, attributes
        self.target, self._read, self._periods = target, {}, {}

    @property
    def time(self):
        """Time, 1/gdot0."""
        return float(self.attributes["time"])

    @property
    def label(self):
        """The progress of the run as a text, for example "5.0 % compression"."""
        if "steady_residual" in self.result.attributes:
            return "steady flow"
        return str(self.attributes.get("label", ""))

    @property
    def kinematics(self):
        """The `pgran.kinematics.Kinematics` of the flow."""
        return self.result.case.kinematics

    @property
    def x(self):
        """Coordinates of the nodes, (ny, nx, 2), d."""
        return self.stored("coordinates")

    def __getitem__(self, name):
        """Return a field of `QUANTITIES` or of the file."""
        return QUANTITIES[name].of(self) if name in QUANTITIES else self.stored(name)

    def stored(self, name):
        """Return a field of the file, (ny, nx, ...); raises `ResultError` if it is missing."""
        if name not in self._read:
            with self._opened() as file:
                self._read[name] = field_of(file, self.name, name)
        return self._read[name]

    @contextmanager
    def _opened(self):
        with self.result.opened(self.name) as file:
            if linked(file).get(self.name, "") != self.target:
                raise ResultError(self.result.path, f"snapshot {self.name} was replaced after it "
                                  "was read, because the run was continued")
            yield file

    @cached_property
    def names(self):
        """Names of the fields of the file, without the coordinates."""
        with self._opened() as file:
            return tuple(name for name in file["snapshots"][self.name] if name != "coordinates")

    def keep(self, fields, periods=None):
        """Replace stored fields, {name: (ny, nx, ...)}, and values of `period`."""
        self._read.update(fields)
        self._periods.update(periods or {})

    def period(self, name):
        """Return the change of a stored field over a period along x1 and x2, (2, ...)."""
        if name not in self._periods:
            with self._opened() as file:
                group = file["snapshots"][self.name]
                attributes = group[name].attrs if name in group else {}
                self._periods[name] = attributes.get("period", np.zeros(2))
        return self._periods[name]

    @cached_property
    def open_ends(self):
        """Whether the grid is periodic but not closed in space, along x1 and x2."""
        return tuple(not closed and bool(np.any(shift)) for closed, shift in zip(
            self.result.closed, self.period("coordinates")))

    @cached_property
    def whole(self):
        """The snapshot with the first nodes repeated in all periodic directions."""
        axes = tuple(map(np.logical_or, self.result.closed, self.open_ends))
        return _Continued(self, axes) if any(axes) else self

    def strain_field(self, name):
        """Return one of `pgran.material.elasticity.strain_fields`, (ny, nx, ...).

        The file of a mode lacks them, so they are computed from velocity and coordinates.
        """
        if name in self._read or name in self.names:
            return self.stored(name)
        x, velocity, since_start = self.whole.x, self.whole.stored("velocity"), None
        if name in ("strain_tensor", "volume_change"):
            since_start = self._gradient(x, self.initial_coordinates)
        values = strain_fields(self.kinematics, self._gradient(velocity, x), since_start)[name]
        found = self._at_nodes(values)
        return found if values.ndim == 2 else np.moveaxis(found, 0, -1)

    @property
    def initial_coordinates(self):
        """Coordinates of the nodes of a moving mesh at the start, with the repeated nodes, d."""
        case, shape = self.result.case, self.whole.x.shape[:2]
        if not case.moving:
            raise ResultError(self.result.path, "its mesh is fixed; the strain since the start is "
                              "undefined")
        j, i = (index.ravel() for index in np.indices(shape))
        return np.moveaxis(case.coordinates(i, j).reshape(2, *shape), 0, -1)

    @cached_property
    def _elements(self):
        """The nodes (9, n) of all elements, in the order of `pgran.space.element`."""
        shape = self.whole.x.shape[:2]
        if min(shape) < 3 or not all(n % 2 for n in shape):
            raise ResultError(self.result.path, f"its {shape[1]} x {shape[0]} nodes do not form "
                              "elements: the file lacks the period of its grid")
        order = sorted(range(len(QUADRATIC)), key=QUADRATIC.__getitem__)
        return np.array(q2_elements(shape)[:, order].T)

    def _gradient(self, values, x):
        """Gradient (c, 2, points, n) and v/r of fields (ny, nx, c), with the repeated nodes."""
        values, x = (np.moveaxis(field, -1, 0).reshape(field.shape[-1], -1)[:, self._elements]
                     for field in (values, x))
        geometry = Geometry(x, axisymmetric=self.kinematics.axisymmetric)
        over_r = None if geometry.over_r is None else element(2).shape @ values * geometry.over_r
        return np.array([geometry.gradient(part) for part in values]), over_r

    def _at_nodes(self, values):
        """Means over elements (..., ny, nx) of values at the Gauss points, (..., points, n)."""
        ny, nx = self.x.shape[:2]
        j, i = np.divmod(self._elements, self.whole.x.shape[1])
        nodes = (j % ny * nx + i % nx).ravel()
        count = np.bincount(nodes, minlength=ny * nx)
        found = [np.bincount(nodes, (element(2).gauss_to_nodes @ part).ravel(), ny * nx) / count
                 for part in values.reshape(-1, *values.shape[-2:])]
        return np.reshape(found, (*values.shape[:-2], ny, nx))

    def band(self):
        """Return the measurements of `pgran.output.band.band`, a dictionary."""
        return band.band(self.x, self["inertial_number"])

    def grid(self, *names):
        """Return a pyvista UnstructuredGrid of Q2 elements with fields at the nodes.

        It has the fields ``names`` (default: all fields of the file), and extends to the end of
        the period. Vectors get a third component of zero.
        """
        import pyvista

        shown = _Continued(self, self.open_ends)
        elements = q2_elements(shown.x.shape[:2], self.result.closed)
        points = np.pad(shown.x.reshape(-1, 2), ((0, 0), (0, 1)))
        grid = pyvista.UnstructuredGrid({pyvista.CellType.BIQUADRATIC_QUAD: elements}, points)
        for name in names or self.names:
            flat = shown[name].reshape(len(points), -1).squeeze()
            grid[name] = np.pad(flat, ((0, 0), (0, 1))) if flat.shape[1:] == (2,) else flat
        return grid


class _Continued(Snapshot):
    """A snapshot with its first nodes repeated at the end of periodic ``axes``, bool (x1, x2)."""

    def __init__(self, snapshot, axes):
        super().__init__(snapshot.result, snapshot.name, snapshot.attributes)
        self._of, self._axes, self.whole, self.open_ends = snapshot, axes, self, (False, False)

    def stored(self, name):
        return self._extended(self._of.stored(name), self._of.period(name))

    def strain_field(self, name):
        return self._extended(self._of.strain_field(name), np.zeros(2))

    def _extended(self, field, period):
        for axis, wrap, shift in zip((1, 0), self._axes, period):
            if wrap:
                field = np.concatenate([field, np.take(field, [0], axis) + shift], axis)
        return field


def options_of(values):
    """Return command-line words of options, such as {"width": 8, "-snes_atol": 1e-6}."""
    words = []
    for name, value in values.items():
        if isinstance(value, (bool, np.bool_)):
            value = str(bool(value)).lower()
        elif isinstance(value, (list, tuple, np.ndarray)):
            value = ",".join(map(str, value))
        words += [name if name.startswith("-") else f"-{PREFIX}{name}", str(value)]
    return words
