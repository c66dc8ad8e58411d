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
from ..material.elasticity import logarithmic_strain
from ..options import PREFIX, ParameterError
from ..space.element import NODES
from . import band
from .reading import ResultError, field_of, opened, stored_parameters
from .snapshots import linked

#: Stands for the identifier of any run.
ANY = object()
#: Order of the nodes of VTK's biquadratic quadrilateral, as places among those of an element.
VTK_NODES = 0, 2, 8, 6, 1, 5, 7, 3, 4


class Quantity(NamedTuple):
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
    (l11, l12), (l21, l22) = snapshot.velocity_gradient
    return np.sqrt(2.0 * (l11**2 + l22**2) + (l12 + l21)**2)


def _spin(snapshot):
    gradient = snapshot.velocity_gradient
    return (gradient[1][0] - gradient[0][1]) / 2.0


def _strain(snapshot):
    """ln(l1/l2), the difference of the principal values of `logarithmic_strain`."""
    h11, h22, h12 = logarithmic_strain(snapshot.deformation_gradient)
    return np.hypot(h11 - h22, 2.0 * h12)


def _volume_change(snapshot):
    (f11, f12), (f21, f22) = snapshot.deformation_gradient
    return f11 * f22 - f12 * f21 - 1.0


def _above_yield(snapshot):
    ratio = snapshot.result.case.law.yield_ratio
    if ratio is None:
        raise ResultError(snapshot.result.path, "its law has no yield value; there is no "
                          "above_yield")
    return snapshot.stored("stress_ratio") - ratio


#: All quantities by name. Gradients at a node are means over its elements.
QUANTITIES = {
    "inertial_number": Quantity("I", "", "inertial number", _stored("inertial_number")),
    "fluidity": Quantity("g", r"$\dot\gamma_0$", "fluidity", _stored("fluidity")),
    "pressure": Quantity("P", "stress", "pressure", _stored("pressure")),
    "stress_ratio": Quantity(r"\mu", "", "stress ratio tau/P", _stored("stress_ratio")),
    "above_yield": Quantity(r"\mu - \mu_s", "", "distance to yield", _above_yield),
    "speed": Quantity("|v|", r"$d\,\dot\gamma_0$", "size of the velocity", _speed),
    "velocity_1": Quantity("v_1", r"$d\,\dot\gamma_0$", "velocity along x1", _part("velocity", 0)),
    "velocity_2": Quantity("v_2", r"$d\,\dot\gamma_0$", "velocity along x2", _part("velocity", 1)),
    "strain_rate": Quantity(r"\dot\gamma", r"$\dot\gamma_0$", "equivalent shear rate sqrt(2 D:D)",
                            _strain_rate),
    "spin": Quantity(r"\omega", r"$\dot\gamma_0$", "spin (d v2/d x1 - d v1/d x2)/2", _spin),
    "strain": Quantity(r"\gamma", "", "equivalent shear strain since the start, ln(l1/l2) of the "
                       "principal stretches", _strain),
    "volume_change": Quantity("J - 1", "", "change of volume since the start", _volume_change),
    "stress_11": Quantity(r"\sigma_{11}", "stress", "stress, tension positive", _stress(0, 1.0)),
    "stress_22": Quantity(r"\sigma_{22}", "stress", "stress, tension positive", _stress(1, 1.0)),
    "stress_12": Quantity(r"\sigma_{12}", "stress", "stress, tension positive", _stress(2, 0.0)),
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
            self.snapshots = [
                Snapshot(self, name, dict(file["snapshots"][name].attrs), target)
                for name, target in linked(file).items()]
        self.options = {row.name: getattr(self.parameters, row.name)
                        for row in self.parameters.rows}

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

    def unit(self, name):
        """Return the unit of a quantity of `QUANTITIES`, empty where it has none."""
        unit = QUANTITIES[name].unit
        return self.case.stress_unit if unit == "stress" else unit


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
        self.target = target
        self._read = {}

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

    def keep(self, fields):
        """Take fields, {name: (ny, nx, ...)}, in place of those of the file."""
        self._read.update(fields)

    def __getitem__(self, name):
        """Return a quantity of `QUANTITIES`, or any other field of the file."""
        return QUANTITIES[name].of(self) if name in QUANTITIES else self.stored(name)

    @property
    def x(self):
        """Coordinates of the nodes, (ny, nx, 2), d."""
        return self.stored("coordinates")

    @cached_property
    def velocity_gradient(self):
        """(2, 2, ny, nx): d v_i/d x_j, gdot0."""
        return self._gradient(self.stored("velocity"), self.x)

    @cached_property
    def deformation_gradient(self):
        """(2, 2, ny, nx): d x_i/d X_j since the start; raises `ResultError` on a fixed mesh."""
        case = self.result.case
        if not case.moving:
            raise ResultError(self.result.path, "its mesh does not move with the material; there "
                              "is no strain since the start")
        ny, nx = self.x.shape[:2]
        j, i = (index.ravel() for index in np.mgrid[:ny, :nx])
        start = np.moveaxis(case.coordinates(i, j).reshape(2, ny, nx), 0, -1)
        return self._gradient(self.x, start)

    def _gradient(self, values, x):
        """Gradient (k, 2, ny, nx) of fields (ny, nx, k) on nodes ``x`` (ny, nx, 2)."""
        (x_1, x_2), (y_1, y_2) = (
            [nodal_slope(x[..., k], axis, self.result.closed[1 - axis]) for axis in (1, 0)]
            for k in range(2))
        area = x_1 * y_2 - x_2 * y_1
        found = []
        for field in np.moveaxis(values, -1, 0):
            along, up = (nodal_slope(field, axis, self.result.closed[1 - axis]) for axis in (1, 0))
            found.append([(along * y_2 - up * y_1) / area, (up * x_1 - along * x_2) / area])
        return np.array(found)

    def band(self):
        """Return what `pgran.output.band.band` measures, a dictionary."""
        return band.band(self.x, self["inertial_number"])

    def grid(self, *names):
        """Return a pyvista UnstructuredGrid of Q2 elements with quantities at the nodes.

        All fields of the file unless ``names`` are given. Vectors and tensors get their zeros.
        """
        import pyvista

        elements = q2_elements(self.x.shape[:2], self.result.closed)
        cells = np.hstack([np.full((len(elements), 1), NODES), elements])
        points = np.pad(self.x.reshape(-1, 2), ((0, 0), (0, 1)))
        grid = pyvista.UnstructuredGrid(
            cells.ravel(), np.full(len(cells), pyvista.CellType.BIQUADRATIC_QUAD), points)
        for name in names or self.names:
            values = self[name]
            flat = values.reshape(len(points), -1)
            grid[name] = flat.ravel() if flat.shape[1] == 1 else (
                np.pad(flat, ((0, 0), (0, 1))) if flat.shape[1] == 2 else flat)
        return grid

    @cached_property
    def names(self):
        """The fields of the file besides the coordinates, a tuple of names."""
        with self._opened() as file:
            return tuple(name for name in file["snapshots"][self.name] if name != "coordinates")


def nodal_slope(values, axis, closed=False):
    """Return the slope of a Q2 field along its nodes, for each step from node to node.

    Parameters
    ----------
    values : ndarray, (ny, nx)
    axis : int
    closed : bool
        Whether the last node neighbours the first one.

    Returns
    -------
    ndarray, (ny, nx)
        That of the parabolas; between two elements their mean.
    """
    f = np.moveaxis(values, axis, 0)
    if closed:
        f = np.concatenate([f[-2:], f, f[:2]])
    inner = (f[2:] - f[:-2]) / 2.0
    bend = f[2:] - 2.0 * f[1:-1] + f[:-2]
    slope = np.empty_like(f)
    slope[1:-1] = inner
    # The parabola through three nodes has the slope inner - bend at the first, inner + bend at the
    # last of them; elements begin at even nodes.
    shared = slope[2:-2:2]
    shared[...] = ((inner + bend)[::2][:len(shared)] + (inner - bend)[2::2][:len(shared)]) / 2.0
    slope[0], slope[-1] = (inner - bend)[0], (inner + bend)[-1]
    return np.moveaxis(slope[2:-2] if closed else slope, 0, axis)


def cells(shape, closed):
    """Return the nodes (n, 4) of the cells between ``shape`` = (ny, nx) nodes, counterclockwise.

    ``closed`` says whether the last nodes along x1 and along x2 neighbour the first ones.
    """
    ny, nx = shape
    wide, high = (n if wrap else n - 1 for n, wrap in zip((nx, ny), closed))
    j, i = (index.ravel() for index in np.mgrid[:high, :wide])
    across, up = (i + 1) % nx, (j + 1) % ny
    return np.stack([j * nx + i, j * nx + across, up * nx + across, up * nx + i], axis=1)


def q2_elements(shape, closed=(False, False)):
    """Return the nodes (n, 9) of the Q2 elements on ``shape`` = (ny, nx) nodes, in VTK's order.

    ``closed`` says whether the last nodes along x1 and x2 neighbour the first ones. On a grid that
    is periodic without being closed in space the last elements have no end and are left out.
    """
    ny, nx = shape
    wide, high = (n // 2 if wrap else (n - 1) // 2 for n, wrap in zip((nx, ny), closed))
    j, i = (2 * index.ravel() for index in np.mgrid[:high, :wide])
    rows = [(j + up) % ny for up in range(3)]
    columns = [(i + along) % nx for along in range(3)]
    nodes = np.stack([row * nx + column for row in rows for column in columns], axis=1)
    return nodes[:, VTK_NODES]


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
