"""The shear band in a result: its angle, its width, the range of I, and differences of meshes.

Every line of nodes that runs up the specimen is a cut through the band. The two points where I
passes half of the cut's maximum bound it. A straight line through the middles gives the angle.
The standard error of this line, and the departure of the two halves of the specimen from each
other, give the uncertainty of the angle. The spread over the cuts gives that of the width. Cuts
on which the half maximum is not passed on both sides are left out.
"""

import numpy as np

from .reading import field_of, opened
from .snapshots import ordered

#: Flow is localised where half the maximum of I is exceeded on less than this share of the area ...
LOCALISED_AREA = 0.5
#: ... and the calmest tenth of the area has less than this share of the maximum.
CALM_RATIO = 0.25


def node_areas(x):
    """Return the area (ny, nx) that belongs to each node of a grid ``x`` (ny, nx, 2), d^2."""
    along, up = x[1:, 1:] - x[:-1, :-1], x[1:, :-1] - x[:-1, 1:]
    quads = np.abs(along[..., 0] * up[..., 1] - along[..., 1] * up[..., 0]) / 2.0
    area = np.zeros(x.shape[:2])
    for rows in (slice(None, -1), slice(1, None)):
        for columns in (slice(None, -1), slice(1, None)):
            area[rows, columns] += quads / 4.0
    return area


def half_maximum_cuts(x, I):
    """Return the points (2, n, 2) where each column passes half its maximum, on both sides.

    ``x`` (ny, nx, 2), ``I`` (ny, nx). Columns that do not, on both sides of the
    maximum, are left out.
    """
    ny, nx = I.shape
    peak, columns = np.argmax(I, axis=0), np.arange(nx)
    half = I[peak, columns] / 2.0
    rows = np.arange(ny)[:, None]
    below = I < half
    above_edge = np.where(below & (rows > peak), rows, ny).min(axis=0)
    below_edge = np.where(below & (rows < peak), rows, -1).max(axis=0)
    kept = np.flatnonzero((above_edge < ny) & (below_edge >= 0))
    points = []
    for outside, inside in ((below_edge, below_edge + 1), (above_edge, above_edge - 1)):
        outside, inside = outside[kept], inside[kept]
        share = ((half[kept] - I[outside, kept]) / (I[inside, kept] - I[outside, kept]))[:, None]
        points.append((1.0 - share) * x[outside, kept] + share * x[inside, kept])
    return np.array(points)


def line_through(points):
    """Return angle (degrees), its standard error, and the mean (2,) of a straight line.

    Least squares in x2 over ``points`` (n, 2).
    """
    mean = points.mean(axis=0)
    d = points - mean
    variance = d[:, 0] @ d[:, 0]
    slope = d[:, 0] @ d[:, 1] / variance
    rest = d[:, 1] - slope * d[:, 0]
    error = np.sqrt(rest @ rest / max(len(points) - 2, 1) / variance) / (1.0 + slope**2)
    return np.degrees(np.arctan(slope)), np.degrees(error), mean


def band(x, I):
    """Return what can be measured of a band, a dictionary.

    ``x`` (ny, nx, 2) coordinates, d; ``I`` (ny, nx) inertial number. Keys: ``angle``
    and ``angle_error`` (degrees), ``width`` and ``width_error`` (d), ``position`` (x2
    at the middle of the specimen, d) - None where no band crosses -; ``localised``;
    ``bands``, how many stretches of the profile normal to the band exceed half its
    maximum; ``asymmetry``, the relative L2 difference of I from I turned by 180
    degrees about the centre, None where nothing flows.
    """
    area = node_areas(x)
    share = area / area.sum()
    order = np.argsort(I, axis=None)
    calm = I.ravel()[order][np.searchsorted(np.cumsum(share.ravel()[order]), 0.1)]
    localised = bool(share[I > I.max() / 2.0].sum() < LOCALISED_AREA
                     and calm < CALM_RATIO * I.max())
    turned = I - I[::-1, ::-1]
    found = {"localised": localised,
             "asymmetry": None,
             "angle": None, "angle_error": None, "width": None, "width_error": None,
             "position": None, "bands": 0}
    if not I.any():
        return found  # nothing flows
    found["asymmetry"] = float(np.sqrt((share * turned**2).sum() / (share * I**2).sum()))
    cuts = half_maximum_cuts(x, I)
    count = cuts.shape[1]
    if count < 8:
        return found
    middles = cuts.mean(axis=0)
    angle, error, mean = line_through(middles)
    order = np.argsort(middles[:, 0])
    halves = [line_through(middles[part])[0] for part in np.array_split(order, 2)]
    normal = np.array([-np.sin(np.radians(angle)), np.cos(np.radians(angle))])
    widths = np.abs((cuts[1] - cuts[0]) @ normal)
    centre = (x[..., 0].min() + x[..., 0].max()) / 2.0
    found.update(angle=float(angle),
                 angle_error=float(np.hypot(error, (halves[1] - halves[0]) / 2.0)),
                 width=float(widths.mean()), width_error=float(widths.std()),
                 position=float(mean[1] + np.tan(np.radians(angle)) * (centre - mean[0])),
                 bands=_count_bands(x, I, share, normal))
    return found


def _count_bands(x, I, share, normal):
    """How many stretches of the mean profile along ``normal`` exceed half its maximum."""
    distance = x @ normal
    spacing = 2.0 * np.sqrt(np.prod(np.ptp(x, axis=(0, 1))) / I.size)
    bins = ((distance - distance.min()) / spacing).astype(int).ravel()
    weight = np.bincount(bins, share.ravel())
    profile = np.bincount(bins, (share * I).ravel()) / np.maximum(weight, 1e-300)
    return stretches(profile > profile.max() / 2.0)


def stretches(inside):
    """Return how many unbroken stretches of True there are in ``inside`` (n,)."""
    before = np.concatenate([[False], inside[:-1]])
    return int(np.count_nonzero(inside & ~before))


def mesh_differences(results):
    """Return how far I changes from each of successive meshes to the next, a list of dictionaries.

    ``results`` = pairs of coordinates (ny, nx, 2) and I (ny, nx) on meshes whose elements are
    divided by those of the next one, so that every node is a node of the next mesh: the same
    material point. ``l2``: the L2 norm of the difference over that of the finer I, with the
    areas of the coarser nodes; ``maximum``: the largest difference over the largest finer I;
    ``order``: log2 of the ratio of successive ``l2`` where elements were halved, else None.
    """
    rows = []
    for (x, coarse), (_, finest) in zip(results, results[1:]):
        step = max(1, (len(finest) - 1) // (len(coarse) - 1))
        fine = finest[::step, ::step]
        if fine.shape != coarse.shape or (len(finest) - 1) % (len(coarse) - 1):
            raise ValueError(f"{finest.shape} nodes do not divide the cells of {coarse.shape}")
        area, apart = node_areas(x), coarse - fine
        l2 = float(np.sqrt((area * apart**2).sum() / (area * fine**2).sum()))
        order = np.log2(rows[-1]["l2"] / l2) if rows and step == rows[-1]["step"] == 2 else None
        rows.append({"step": step, "l2": l2, "order": order,
                     "maximum": float(np.abs(apart).max() / finest.max())})
    return rows


def measure(path):
    """Return what is measured in each snapshot of a result file, a list of dictionaries.

    These are the values of `band`, the attributes of the snapshot (``time``, ``label``, and what
    its case is counted by, such as ``compression``), ``inertial_number_min`` and
    ``inertial_number_max``.
    Raises `pgran.output.reading.ResultError` where the file is not one of pgran's.
    """
    found = []
    with opened(path, snapshots=1) as file:
        for snapshot in ordered(file["snapshots"]):
            I = field_of(file, snapshot, "inertial_number")
            attributes = {name: value if isinstance(value, str) else float(value)
                          for name, value in file["snapshots"][snapshot].attrs.items()}
            found.append({**attributes, "inertial_number_min": float(I.min()),
                          "inertial_number_max": float(I.max()),
                          **band(field_of(file, snapshot, "coordinates"), I)})
    return found


def compare(paths):
    """Return `mesh_differences` of the last snapshots of result files."""
    results = []
    for path in paths:
        with opened(path, snapshots=1) as file:
            last = ordered(file["snapshots"])[-1]
            results.append(tuple(field_of(file, last, name)
                                 for name in ("coordinates", "inertial_number")))
    return mesh_differences(results)
