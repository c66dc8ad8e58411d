"""The shear bands in a result: their angles and widths, the range of I, and differences of meshes.

The lines of nodes that run up the specimen, and then those that run across it, are cuts through the
bands. On each cut, I exceeds half of a local maximum on a stretch between two points. Stretches of
adjacent cuts that overlap continue each other. A band is a chain of stretches that crosses the
specimen. It is interrupted where bands branch or cross: the parts on both sides belong to one band
if one straight line fits them and their widths agree. A straight line through the middles of the
stretches gives the angle. The standard error of this line, and the difference between the two
halves of the band, give the error of the angle. The spread over the cuts gives the error of the
width. Cuts on which a stretch reaches the boundary are left out. Steep bands are measured on the
cuts across the specimen: the direction of the cuts that cover more of the longest band counts.

No band is reported if flow is not localised, or if no chain crosses the specimen, is long enough
and straight enough. `band` gives the reason.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import find_peaks
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from .reader import field_of, opened
from .snapshots import ordered

#: AcceptedStep is localised where half the maximum of I is exceeded on less than this share of the area ...
LOCALISED_AREA = 0.5
#: ... and the calmest tenth of the area has less than this share of the maximum.
CALM_RATIO = 0.25
#: Stretches have a maximum of at least this share of the largest I.
LEAST_PEAK = 1.0 / 3.0
#: A band is measured on at least this many cuts, ...
MIN_CUTS = 8
#: ... is at least this many times as long as wide, ...
MIN_ELONGATION = 1.5
#: ... and is so straight that the error of its angle is at most this, degrees.
MAX_ANGLE_ERROR = 3.0
#: Another band joins a band where its width grows or shrinks by more than this factor in one cut.
MAX_WIDTH_STEP = 1.3
#: Parts of a band on both sides of a branch are joined if the width varies by at most this share.
MAX_WIDTH_SPREAD = 0.1


def node_areas(x):
    """Return the area (ny, nx) that belongs to each node of a grid ``x`` (ny, nx, 2), d^2."""
    along, up = x[1:, 1:] - x[:-1, :-1], x[1:, :-1] - x[:-1, 1:]
    quads = np.abs(along[..., 0] * up[..., 1] - along[..., 1] * up[..., 0]) / 2.0
    area = np.zeros(x.shape[:2])
    for rows in (slice(None, -1), slice(1, None)):
        for columns in (slice(None, -1), slice(1, None)):
            area[rows, columns] += quads / 4.0
    return area


class Stretch(NamedTuple):
    """A part of a cut on which I exceeds half of its maximum there.

    ``cut`` is the number of the cut, ``low`` and ``high`` the first and the last node of the
    stretch, and ``ends`` (2, 2) the points where I passes half the maximum; None if the stretch
    reaches an end of the cut.
    """

    cut: int
    low: int
    high: int
    ends: np.ndarray


def stretches_of(number, x, I, least):
    """Return the `Stretch`es of one cut whose maxima are at least ``least``, a list.

    ``x`` (n, 2) coordinates and ``I`` (n,) along the cut. A local maximum between which and a
    higher one I stays above half the lower maximum has no stretch.
    """
    peaks, _ = find_peaks(np.pad(I, 1, constant_values=-np.inf), height=least)
    taken, found = np.zeros(I.size, dtype=bool), []
    for peak in sorted(peaks - 1, key=lambda node: -I[node]):
        half = I[peak] / 2.0
        outside = np.concatenate([[-1], np.flatnonzero(I < half), [I.size]])
        after = np.searchsorted(outside, peak)
        low, high = outside[after - 1] + 1, outside[after] - 1
        if taken[low:high + 1].any():
            continue
        taken[low:high + 1] = True
        ends = None
        if low > 0 and high < I.size - 1:
            inside, beyond = np.array([low, high]), np.array([low - 1, high + 1])
            share = ((half - I[beyond]) / (I[inside] - I[beyond]))[:, None]
            ends = (1.0 - share) * x[beyond] + share * x[inside]
        found.append(Stretch(number, low, high, ends))
    return found


class Segment(NamedTuple):
    """Stretches of successive cuts, each of which overlaps one stretch of the next cut only.

    ``component`` is the number of the connected set of stretches, and ``leaves`` says of the first
    and of the last stretch whether the segment goes on to the boundary of the specimen there
    (True), ends inside the specimen (False) or branches (None).
    """

    stretches: list
    component: int
    leaves: tuple


def segments_of(cuts):
    """Return the `Segment`s of the stretches of successive cuts, ``cuts`` a list of lists."""
    every = [stretch for cut in cuts for stretch in cut]
    first = np.concatenate([[0], np.cumsum([len(cut) for cut in cuts])])
    after, before = [[] for _ in every], [[] for _ in every]
    for k, (cut, following) in enumerate(zip(cuts, cuts[1:])):
        for i, a in enumerate(cut, first[k]):
            for j, b in enumerate(following, first[k + 1]):
                if a.low <= b.high and b.low <= a.high:
                    after[i].append(j)
                    before[j].append(i)
    rows = np.repeat(np.arange(len(every)), [len(links) for links in after])
    columns = np.array([j for links in after for j in links], dtype=int)
    component = connected_components(
        coo_matrix((np.ones(rows.size), (rows, columns)), shape=(len(every),) * 2),
        directed=False)[1] if every else []

    def only(links, back, node):
        """The one node that ``node`` is linked to, and that is linked to no other; or None."""
        if len(links[node]) != 1 or len(back[links[node][0]]) != 1:
            return None
        return links[node][0] if alike(every[node], every[links[node][0]]) else None

    def alike(a, b):
        if a.ends is None or b.ends is None:
            return True
        lengths = [np.hypot(*(stretch.ends[1] - stretch.ends[0])) for stretch in (a, b)]
        return max(lengths) <= MAX_WIDTH_STEP * min(lengths)

    def leaves(links, node):
        if links[node]:
            return None
        return every[node].cut in (0, len(cuts) - 1) or every[node].ends is None

    found = []
    for node in range(len(every)):
        if only(before, after, node) is not None:
            continue
        chain = [node]
        while (following := only(after, before, chain[-1])) is not None:
            chain.append(following)
        found.append(Segment([every[k] for k in chain], component[node],
                             (leaves(before, chain[0]), leaves(after, chain[-1]))))
    return found


def line_through(points, along):
    """Return slope, its standard error, and the mean (2,) of a straight line.

    Least squares over ``points`` (n, 2) in the coordinate 1 - ``along``: the slope is that of this
    coordinate over the coordinate ``along``.
    """
    mean = points.mean(axis=0)
    d = points - mean
    a, b = d[:, along], d[:, 1 - along]
    variance = a @ a
    slope = a @ b / variance
    rest = b - slope * a
    return slope, np.sqrt(rest @ rest / max(len(points) - 2, 1) / variance), mean


def straight_band(stretches, along):
    """Return what is measured of a straight band through complete stretches, a dictionary.

    The cuts run along the coordinate 1 - ``along``. See `band` for the keys; ``length`` (d) is
    that of the part of the band that the cuts cover.
    """
    ends = np.array([stretch.ends for stretch in stretches])
    middles = ends.mean(axis=1)
    slope, error, mean = line_through(middles, along)
    order = np.argsort(middles[:, along])
    halves = [np.arctan(line_through(middles[part], along)[0])
              for part in np.array_split(order, 2)]
    direction = np.ones(2)
    direction[1 - along] = slope
    direction /= np.hypot(*direction)
    angle = np.degrees(np.arctan2(direction[1], direction[0]))
    widths = np.abs((ends[:, 1] - ends[:, 0]) @ [-direction[1], direction[0]])
    return {"angle": float(angle if angle <= 90.0 else angle - 180.0),
            "angle_error": float(np.degrees(np.hypot(error / (1.0 + slope**2),
                                                     (halves[1] - halves[0]) / 2.0))),
            "width": float(widths.mean()), "width_error": float(widths.std()),
            "centre": mean.tolist(), "length": float(np.ptp(middles @ direction))}


def bands_along(x, I, along):
    """Return the bands that cross the specimen, and why other candidates are no bands.

    The cuts are the lines of nodes that do not run along the coordinate ``along``. Returns a list
    of dictionaries of `straight_band`, the band with the largest I first; a list of pairs (length
    in d, reason); and the number of those that are straight parts of further bands.
    """
    if along == 1:
        x, I = x.swapaxes(0, 1), I.T
    least = LEAST_PEAK * I.max()
    segments = segments_of([stretches_of(k, x[:, k], I[:, k], least) for k in range(I.shape[1])])
    pool = sorted(segments, key=lambda segment: -len(segment.stretches))
    bands, refused, parts = [], [], []
    while pool:
        group = [pool.pop(0)]
        for other in list(pool):
            joined = _join(group, other, along)
            if joined:
                group = joined
                pool.remove(other)
        stretches = [stretch for segment in group for stretch in segment.stretches]
        complete = [stretch for stretch in stretches if stretch.ends is not None]
        if len(stretches) < MIN_CUTS:
            continue
        if len(complete) < MIN_CUTS:
            refused.append((0.0, "the boundary cuts off the stretch where I exceeds half of its "
                            f"maximum on {len(stretches) - len(complete)} of {len(stretches)} "
                            f"cuts; {MIN_CUTS} whole cuts are needed"))
            continue
        found = straight_band(complete, along)
        reason = _refusal(group[0].leaves[0], group[-1].leaves[1], found)
        if reason:
            refused.append((found["length"], reason))
            if (found["length"] >= MIN_ELONGATION * found["width"]
                    and found["angle_error"] <= MAX_ANGLE_ERROR):
                parts.append(found)
        else:
            found["inertial_number"] = float(np.mean([
                I[stretch.low:stretch.high + 1, stretch.cut].max() for stretch in complete]))
            bands.append(found)
    count = sum(not any(_lies_on(part, other) for other in bands) for part in parts)
    return sorted(bands, key=lambda found: -found["inertial_number"]), refused, count


def _lies_on(part, other):
    """Whether the middle of a part lies on another band, as where two bands cross."""
    angle = np.radians(other["angle"])
    apart = np.subtract(part["centre"], other["centre"]) @ [-np.sin(angle), np.cos(angle)]
    return abs(apart) < other["width"] / 2.0


def _join(group, other, along):
    """The segments of a group and another one in order, if one straight line fits them, or None."""
    joined = sorted([*group, other], key=lambda segment: segment.stretches[0].cut)
    if other.component != group[0].component or any(
            a.stretches[-1].cut >= b.stretches[0].cut for a, b in zip(joined, joined[1:])):
        return None
    complete = [stretch for segment in joined for stretch in segment.stretches
                if stretch.ends is not None]
    if len(complete) < MIN_CUTS:
        return None
    found = straight_band(complete, along)
    one = (found["angle_error"] <= MAX_ANGLE_ERROR
           and found["width_error"] <= MAX_WIDTH_SPREAD * found["width"])
    return joined if one else None


def _refusal(first, last, found):
    """Why a candidate is no band, in words, or None; ``first`` and ``last`` as in `Segment`."""
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
                f"degrees (at most {MAX_ANGLE_ERROR:g} are allowed)")
    return None


def band(x, I):
    """Return what can be measured of the bands of a snapshot.

    Parameters
    ----------
    x : ndarray, (ny, nx, 2)
        Coordinates of the nodes, d.
    I : ndarray, (ny, nx)
        Inertial number.

    Returns
    -------
    dict
        ``localised`` : bool, see `LOCALISED_AREA` and `CALM_RATIO`.
        ``asymmetry`` : the relative L2 difference of I from I turned by 180 degrees about the
        centre, None where nothing flows.
        ``bands`` : the number of bands.
        ``parts`` : the number of further straight parts of bands, which end at a branch or inside
        the specimen.
        ``each_band`` : list of dictionaries with the angle of each band with the x1 axis and its
        error (``angle``, ``angle_error``, degrees, -90 < angle <= 90), the full width at half
        maximum and its spread along the band (``width``, ``width_error``, d), a point in the
        middle of the band (``centre``, [x1, x2], d), the length that was measured (``length``, d)
        and the mean over the cuts of the largest I (``inertial_number``). The band with the
        largest ``inertial_number`` comes first.
        ``angle``, ``angle_error``, ``width``, ``width_error``, ``centre`` : those of the first
        band, None where there is no band.
        ``reason`` : why there is no band, None where there is one.
    """
    keys = "angle", "angle_error", "width", "width_error", "centre"
    found = {"localised": False, "asymmetry": None, **dict.fromkeys(keys), "bands": 0, "parts": 0,
             "each_band": [], "reason": "nothing flows"}
    if not (I > 0.0).any():
        return found
    area = node_areas(x)
    share = area / area.sum()
    turned = I - I[::-1, ::-1]
    found["asymmetry"] = float(np.sqrt((share * turned**2).sum() / (share * I**2).sum()))
    found["reason"] = _why_not_localised(share, I)
    found["localised"] = found["reason"] is None
    if not found["localised"]:
        return found
    directions = [bands_along(x, I, along) for along in (0, 1)]
    bands, _, parts = max(directions, key=lambda direction: max(
        (row["length"] for row in direction[0]), default=0.0))
    if bands:
        return {**found, "bands": len(bands), "parts": parts, "each_band": bands, "reason": None,
                **{key: bands[0][key] for key in keys}}
    found["parts"] = max(parts for _, _, parts in directions)
    refused = [row for _, rows, _ in directions for row in rows]
    found["reason"] = max(refused, default=(0.0, "no stretch where I exceeds half of its maximum "
                                            "continues from cut to cut"))[1]
    return found


def _why_not_localised(share, I):
    """Why a flow is not localised, in words, or None; ``share`` (ny, nx) of the area of nodes."""
    order = np.argsort(I, axis=None)
    calm = I.ravel()[order][np.searchsorted(np.cumsum(share.ravel()[order]), 0.1)]
    above = share[I > I.max() / 2.0].sum()
    if above >= LOCALISED_AREA:
        return (f"I exceeds half of its maximum on {100 * above:.0f} % of the area (localised: "
                f"less than {100 * LOCALISED_AREA:.0f} %)")
    if calm >= CALM_RATIO * I.max():
        return (f"on 90 % of the area I exceeds {100 * calm / I.max():.0f} % of its maximum "
                f"(localised: at most {100 * CALM_RATIO:.0f} %)")
    return None


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
    Raises `pgran.output.reader.ResultError` where the file is not one of pgran's.
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
