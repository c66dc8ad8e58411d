"""Shear bands in a field of the inertial number I: angles, widths, and differences between meshes.

Lines of nodes, up the specimen and then across it, cut through the bands. On each cut, I exceeds
half of a local maximum on a stretch. A chain of overlapping stretches of adjacent cuts that crosses
the specimen is a band. Chains end where bands branch or cross: the parts on both sides are one band
if one straight line fits them and their widths agree. The angle is the slope of a line fitted to
the middles of the stretches. Its error combines the standard error of the fit and the difference
between the two halves of the band. The error of the width is its standard deviation over the cuts.
Stretches that reach the boundary are not measured. Of the two families of cuts, the one with the
longest band is used.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import find_peaks, peak_widths
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.stats import linregress

from .reader import field_of, opened
from .snapshots import ordered

#: Flow is localised if I exceeds half of its maximum on less than this share of the area, ...
LOCALISED_AREA = 0.5
#: ... and if the 10th percentile of I is less than this share of the maximum.
PERCENTILE_RATIO = 0.25
#: Smallest local maximum of a stretch relative to the largest I.
LEAST_PEAK = 1.0 / 3.0
#: Smallest number of cuts of a band, ...
MIN_CUTS = 8
#: ... smallest ratio of its length to its width, ...
MIN_ELONGATION = 1.5
#: ... and largest error of its angle, degrees.
MAX_ANGLE_ERROR = 3.0
#: A chain ends where the length of stretches changes by more than this factor from cut to cut.
MAX_WIDTH_STEP = 1.3
#: Largest relative error of the width of a band that is joined across a branch.
MAX_WIDTH_SPREAD = 0.1


def node_areas(x):
    """Return the area (ny, nx) that belongs to each node of a grid ``x`` (ny, nx, 2), d^2."""
    along, up = x[1:, 1:] - x[:-1, :-1], x[1:, :-1] - x[:-1, 1:]
    quads = np.abs(along[..., 0] * up[..., 1] - along[..., 1] * up[..., 0]) / 2.0
    q = np.pad(quads / 4.0, 1)
    return q[1:, 1:] + q[1:, :-1] + q[:-1, 1:] + q[:-1, :-1]


class Stretch(NamedTuple):
    """The part of a cut where I exceeds half of a local maximum."""

    cut: int  # number of the cut
    low: int  # first and last node
    high: int
    ends: np.ndarray  # (2, 2), points where I equals half of the maximum; None at the boundary


def stretches_of(number, x, I, least):
    """Return the `Stretch`es of a cut with maxima of at least ``least``, the highest first."""
    peaks, _ = find_peaks(np.pad(I, 1, constant_values=-np.inf), height=least)
    peaks = peaks[np.argsort(-I[peaks - 1], kind="stable")] - 1
    # A prominence equal to the peak makes `peak_widths` search for half of the peak.
    _, _, first, last = peak_widths(I, peaks, 0.5, (
        I[peaks], np.zeros_like(peaks), np.full_like(peaks, I.size - 1)))
    lows, highs = np.ceil(first).astype(int), np.floor(last).astype(int)
    nodes, found, taken = np.arange(I.size), [], np.zeros(I.size, dtype=bool)
    for low, high, positions in zip(lows, highs, np.stack([first, last], axis=1)):
        if not taken[low:high + 1].any():
            taken[low:high + 1] = True
            complete = low > 0 and high < I.size - 1
            ends = np.stack([np.interp(positions, nodes, part) for part in x.T], axis=1)
            found.append(Stretch(number, low, high, ends if complete else None))
    return found


class Segment(NamedTuple):
    """A chain of stretches of successive cuts without branches."""

    stretches: list
    component: int  # number of the connected set of stretches
    leaves: tuple  # for both ends: at the boundary (True), inside (False) or at a branch (None)


def segments_of(cuts):
    """Return each `Segment` in lists of stretches on successive cuts."""
    every = [stretch for cut in cuts for stretch in cut]
    if not every:
        return []
    first = np.cumsum([0, *map(len, cuts), 0])
    pairs = [(i, j) for i, a in enumerate(every) for j in range(*first[a.cut + 1:a.cut + 3])
             if a.low <= every[j].high and every[j].low <= a.high]
    rows, columns = np.array(pairs, dtype=int).reshape(-1, 2).T
    after, before = (np.bincount(nodes, minlength=len(every)) for nodes in (rows, columns))
    links = coo_matrix((np.ones(len(pairs)), (rows, columns)), shape=2 * (len(every),))
    _, component = connected_components(links, directed=False)

    def similar(*stretches):
        lengths = [np.hypot(*np.subtract(*stretch.ends)) for stretch in stretches
                   if stretch.ends is not None]
        return len(lengths) < 2 or max(lengths) <= MAX_WIDTH_STEP * min(lengths)

    def leaves(node, links):
        if links[node]:
            return None
        return every[node].cut in (0, len(cuts) - 1) or every[node].ends is None

    following = {i: j for i, j in pairs
                 if after[i] == before[j] == 1 and similar(every[i], every[j])}
    segments = []
    for node in sorted(set(range(len(every))) - set(following.values())):
        chain = [node]
        while chain[-1] in following:
            chain.append(following[chain[-1]])
        segments.append(Segment([every[k] for k in chain], component[node],
                                (leaves(chain[0], before), leaves(chain[-1], after))))
    return segments


def straight_band(segments, I, along):
    """Return ``each_band`` of `band` for segments; None with too few complete cuts."""
    stretches = [stretch for segment in segments for stretch in segment.stretches
                 if stretch.ends is not None]
    if len(stretches) < MIN_CUTS:
        return None
    ends = np.array([stretch.ends for stretch in stretches])
    middles = ends.mean(axis=1)
    a, b = middles[:, along], middles[:, 1 - along]
    fit = linregress(a, b)
    halves = [np.arctan(linregress(a[part], b[part]).slope)
              for part in np.array_split(np.argsort(a), 2)]
    direction = np.roll([1.0, fit.slope], along) / np.hypot(1.0, fit.slope)
    angle = np.degrees(np.arctan2(direction[1], direction[0]))
    widths = np.abs((ends[:, 1] - ends[:, 0]) @ [-direction[1], direction[0]])
    largest = [I[stretch.low:stretch.high + 1, stretch.cut].max() for stretch in stretches]
    return {"angle": float(angle if angle <= 90.0 else angle - 180.0),
            "angle_error": float(np.degrees(np.hypot(
                fit.stderr / (1.0 + fit.slope**2), (halves[1] - halves[0]) / 2.0))),
            "width": float(widths.mean()), "width_error": float(widths.std()),
            "centre": middles.mean(axis=0).tolist(), "length": float(np.ptp(middles @ direction)),
            "inertial_number": float(np.mean(largest))}


def bands_along(x, I, along):
    """Return bands, pairs (length, reason) of rejected candidates, and the number of parts.

    The cuts do not run along the coordinate ``along``.
    """
    if along == 1:
        x, I = x.swapaxes(0, 1), I.T
    least = LEAST_PEAK * I.max()
    segments = segments_of([stretches_of(k, x[:, k], I[:, k], least) for k in range(I.shape[1])])
    remaining = sorted(segments, key=lambda segment: -len(segment.stretches))
    bands, rejected, parts = [], [], []
    while remaining:
        group = [remaining.pop(0)]
        for other in list(remaining):
            joined = sorted([*group, other], key=lambda segment: segment.stretches[0].cut)
            if _one_band(joined, I, along):
                group = joined
                remaining.remove(other)
        cuts = sum(len(segment.stretches) for segment in group)
        if cuts < MIN_CUTS:
            continue
        found = straight_band(group, I, along)
        if not found:
            rejected.append((0.0, "the boundary cuts off the stretch where I exceeds half of its "
                             f"maximum; fewer than {MIN_CUTS} of {cuts} cuts are complete"))
        elif reason := _reason(group[0].leaves[0], group[-1].leaves[1], found):
            rejected.append((found["length"], reason))
            if (found["length"] >= MIN_ELONGATION * found["width"]
                    and found["angle_error"] <= MAX_ANGLE_ERROR):
                parts.append(found)
        else:
            bands.append(found)
    count = sum(not any(_lies_on(part, other) for other in bands) for part in parts)
    return sorted(bands, key=lambda found: -found["inertial_number"]), rejected, count


def _one_band(segments, I, along):
    """Return whether connected segments on successive cuts are one straight band."""
    if (len({segment.component for segment in segments}) > 1
            or any(a.stretches[-1].cut >= b.stretches[0].cut
                   for a, b in zip(segments, segments[1:]))):
        return False
    found = straight_band(segments, I, along)
    return bool(found) and (found["angle_error"] <= MAX_ANGLE_ERROR
                            and found["width_error"] <= MAX_WIDTH_SPREAD * found["width"])


def _lies_on(part, other):
    """Return whether the centre of a part lies on another band, as where two bands cross."""
    angle = np.radians(other["angle"])
    distance = np.subtract(part["centre"], other["centre"]) @ [-np.sin(angle), np.cos(angle)]
    return abs(distance) < other["width"] / 2.0


def _reason(first, last, found):
    """Return why a candidate is not a band, or None; ``first`` and ``last`` as in `Segment`."""
    if None in (first, last):
        return "bands branch or cross"
    if not first or not last:
        return "the stretch where I exceeds half of its maximum does not cross the specimen"
    if found["length"] < MIN_ELONGATION * found["width"]:
        return (f"the stretch where I exceeds half of its maximum is {found['length']:.1f} d long "
                f"and {found['width']:.1f} d wide (a band is at least {MIN_ELONGATION:g} times as "
                "long as wide)")
    if found["angle_error"] > MAX_ANGLE_ERROR:
        return (f"the band is not straight: the error of its angle is {found['angle_error']:.1f} "
                f"degrees (maximum {MAX_ANGLE_ERROR:g})")
    return None


def band(x, I):
    """Return the measurements of the shear bands of I (ny, nx) at nodes ``x`` (ny, nx, 2), d.

    Returns
    -------
    dict
        ``localised`` : bool, see `LOCALISED_AREA` and `PERCENTILE_RATIO`.
        ``asymmetry`` : relative L2 difference between I and I rotated by 180 degrees.
        ``bands`` : number of bands.
        ``parts`` : number of straight parts that end at a branch or inside the specimen.
        ``each_band`` : list of dictionaries, largest ``inertial_number`` (mean over the cuts)
        first: ``angle`` with the x1 axis and ``angle_error`` (degrees, -90 < angle <= 90), full
        ``width`` at half maximum and ``width_error`` (d), ``centre`` ([x1, x2], d), and ``length``
        (d).
        ``angle``, ``angle_error``, ``width``, ``width_error``, ``centre`` : values of the first
        band, None without a band.
        ``reason`` : why there is no band, None if there is one.
    """
    keys = "angle", "angle_error", "width", "width_error", "centre"
    found = {"localised": False, "asymmetry": None, **dict.fromkeys(keys), "bands": 0, "parts": 0,
             "each_band": [], "reason": "nothing flows"}
    if not (I > 0.0).any():
        return found
    area = node_areas(x)
    share = area / area.sum()
    found["asymmetry"] = float(np.sqrt((share * (I - I[::-1, ::-1])**2).sum()
                                       / (share * I**2).sum()))
    if reason := _not_localised(share, I):
        return {**found, "reason": reason}
    directions = [bands_along(x, I, along) for along in (0, 1)]
    bands, _, parts = max(directions, key=lambda direction: max(
        (row["length"] for row in direction[0]), default=0.0))
    found["localised"] = True
    if bands:
        return {**found, "bands": len(bands), "parts": parts, "each_band": bands, "reason": None,
                **{key: bands[0][key] for key in keys}}
    _, reason = max((row for _, rows, _ in directions for row in rows), default=(
        0.0, "no stretch where I exceeds half of its maximum continues from cut to cut"))
    return {**found, "parts": max(parts for _, _, parts in directions), "reason": reason}


def _not_localised(share, I):
    """Return why a flow is not localised, or None; ``share`` (ny, nx) of the area of each node."""
    order = np.argsort(I, axis=None)
    percentile = I.ravel()[order][np.searchsorted(np.cumsum(share.ravel()[order]), 0.1)]
    above = share[I > I.max() / 2.0].sum()
    if above >= LOCALISED_AREA:
        return (f"I exceeds half of its maximum on {100 * above:.0f} % of the area (localised: "
                f"less than {100 * LOCALISED_AREA:.0f} %)")
    if percentile >= PERCENTILE_RATIO * I.max():
        return (f"on 90 % of the area I exceeds {100 * percentile / I.max():.0f} % of its maximum "
                f"(localised: at most {100 * PERCENTILE_RATIO:.0f} %)")
    return None


def stretches(inside):
    """Return the number of unbroken stretches of True in ``inside`` (n,)."""
    return np.count_nonzero(np.diff(inside.astype(int), prepend=0) > 0)


def mesh_differences(results):
    """Return differences of I between successive meshes at common nodes, a list of dictionaries.

    ``results`` contains pairs of coordinates (ny, nx, 2), d, and I (ny, nx), coarsest mesh first.
    Each mesh divides the elements of the previous one. ``l2`` is the L2 norm of the difference over
    the norm of the finer I, ``maximum`` the largest difference over the largest finer I, ``order``
    log2 of the ratio of successive ``l2`` if elements were halved twice, ``step`` the size ratio.
    """
    rows = []
    for (x, coarse), (_, finest) in zip(results, results[1:]):
        step = max(1, (len(finest) - 1) // (len(coarse) - 1))
        fine = finest[::step, ::step]
        if fine.shape != coarse.shape or (len(finest) - 1) % (len(coarse) - 1):
            raise ValueError(f"{finest.shape} nodes do not divide the cells of {coarse.shape}")
        area, difference = node_areas(x), coarse - fine
        l2 = float(np.sqrt((area * difference**2).sum() / (area * fine**2).sum()))
        order = np.log2(rows[-1]["l2"] / l2) if rows and step == rows[-1]["step"] == 2 else None
        rows.append({"step": step, "l2": l2, "order": order,
                     "maximum": float(np.abs(difference).max() / finest.max())})
    return rows


def measure(path):
    """Return the measurements of each snapshot of a result file, a list of dictionaries.

    Each holds the values of `band`, the attributes of the snapshot (such as ``time``, ``label`` and
    ``compression``), ``inertial_number_min`` and ``inertial_number_max``.
    """
    rows = []
    with opened(path, snapshots=1) as file:
        for name in ordered(file["snapshots"]):
            x, I = _fields(file, name)
            attributes = {key: value if isinstance(value, str) else float(value)
                          for key, value in file["snapshots"][name].attrs.items()}
            rows.append({**attributes, "inertial_number_min": float(I.min()),
                         "inertial_number_max": float(I.max()), **band(x, I)})
    return rows


def compare(paths):
    """Return `mesh_differences` of the last snapshots of result files."""
    results = []
    for path in paths:
        with opened(path, snapshots=1) as file:
            results.append(_fields(file, ordered(file["snapshots"])[-1]))
    return mesh_differences(results)


def _fields(file, snapshot):
    return [field_of(file, snapshot, name) for name in ("coordinates", "inertial_number")]
