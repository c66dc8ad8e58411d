"""Stopping height on an inclined plane, dynamic NGF: stopping [directory]

H_stop over the slope in three ways: the analytical (pi/2) xi(mu); the height at which the fluidity
of steady flow vanishes; and the height at which the leading eigenvalue of the layer at rest, g = 0,
changes its sign in the solver's Jacobian. Then layers thinner and thicker than H_stop that start
almost at rest and from flow. About three minutes on two cores.
"""

from pathlib import Path

import numpy as np

from pgran import cases
from pgran.runs import run_on_ranks
from pgran.theory import profiles

from .flows import errors
from .study import Report, command, run

SLOPES = 22, 23, 24, 25, 26, 28, 30
#: Tolerances of steady flow whose fluidity is nearly zero.
STRICT = "-ts_pseudo_fatol", 1e-13, "-snes_atol", 1e-14, "-snes_rtol", 1e-8
#: Elements across the layer.
ELEMENTS = 24
#: Heights over H_stop at which flow and rest are computed.
FLOWING, RESTING = (1.02, 1.04, 1.06, 1.08), (0.95, 1.05)
#: Time in which the layer at rest may deform elastically, 1/gdot0. The eigenvalue does not depend
#: on it, but rounding hides it in a very stiff layer.
SOFT = 0.01
#: Its shear modulus, phi rho_s G d: the rotation of the stress must not change mu.
RIGID = 1e5
#: Relaxation time, 1/gdot0; slopes, heights over H_stop and end (1/gdot0) of layers in time. The
#: rate near H_stop is (A d/xi)^2 (1 - (H_stop/H)^2)/t0: the end is long after.
TIME, FOLLOWED, SHARES, END = 1.0, (24, 28), (0.9, 0.98, 1.02, 1.1), 10000
#: Fluidity at the start over that of the reference flow: almost at rest, and flowing.
STARTS = 1e-6, 1.0
FILE = "inclined_plane"


def layer(slope, height, *options):
    """Return the options of a layer of dynamic NGF."""
    side = float(height) / ELEMENTS
    return ("-pgran_model", "ngf_primitive", "-pgran_relaxation_time", TIME, "-pgran_slope", slope,
            "-pgran_grading", 2, "-pgran_height", float(height), "-pgran_element_size", side,
            "-pgran_width", 2 * side, *options)


def flowing(directory, slope, known, *options):
    """Return the height, d, at which the largest fluidity of steady flow goes to zero.

    It is extrapolated by the polynomial through the heights `FLOWING`. Returns also the largest
    error of velocity among them, over its maximum.
    """
    largest, far = [], []
    for share in FLOWING:
        path = directory / f"flow_{slope}_{share:g}.h5"
        found = run(path, FILE, *layer(slope, share * known), *STRICT, *options)
        largest.append(found.snapshots[-1]["fluidity"].max())
        far.append(errors(path)[0])
    # Height as a polynomial of the fluidity, at the fluidity zero.
    return known * float(np.polyfit(largest, FLOWING, len(FLOWING) - 1)[-1]), max(far)


def resting(directory, slope, known, *options):
    """Return the height, d, at which the leading eigenvalue of rest changes its sign.

    The eigenvalue is linear in 1/H^2, so that two heights are enough.
    """
    rates = []
    for share in RESTING:
        path = directory / f"rest_{slope}_{share:g}.h5"
        run(path, FILE, *layer(slope, share * known), "-ts_type", "beuler", "-pgran_start_fluidity",
            0, "-pgran_shear_modulus", RIGID, "-pgran_end_time", 1, *options)
        rows = command(1, "pgran.eigen", "-pgran_restart", path, "-pgran_steady_time", SOFT)
        rates.append(rows[0]["computed"])
    inverse = np.interp(0.0, rates, [share**-2 for share in RESTING])
    return known / float(np.sqrt(inverse))


def followed(directory, slope, height, start, *options):
    """Return the largest fluidity at the start and at the end of a layer followed in time."""
    path = directory / f"time_{slope}_{height:.3f}_{start:g}.h5"
    found = run(
        path, FILE, *layer(slope, height), "-ts_type", "beuler", "-ts_max_steps", 100000,
        "-pgran_shear_modulus", RIGID, "-pgran_start_fluidity", start, "-pgran_step_max", 20,
        "-pgran_end_time", END, "-pgran_rest_speed", 0, "-pgran_snapshots", 1e-3, *options)
    return [snapshot["fluidity"].max() for snapshot in found.snapshots[:2]]


def main(directory="results/stopping", *, options=()):
    """Make the runs and the tables."""
    directory = Path(directory)
    case = cases.create(run_on_ranks.requested_parameters(f"options/{FILE}.opts", *layer(SLOPES[0], 10.0)))
    amplitude, known = case.parameters.A, {}
    table = Report(directory / "stopping.csv", {
        "slope": "g", "analytical (d)": ".5f", "end of flow (d)": ".5f", "difference": ".1e",
        "zero of the eigenvalue (d)": ".5f", "difference ": ".1e", "error of velocity": ".1e"})
    for slope in SLOPES:
        known[slope] = profiles.stopping_height(case.law, amplitude, slope)
        end, far = flowing(directory, slope, known[slope], *options)
        zero = resting(directory, slope, known[slope], *options)
        table.row(slope, known[slope], end, end / known[slope] - 1.0, zero,
                  zero / known[slope] - 1.0, far)
    table = Report(directory / "followed.csv", {
        "slope": "g", "H/H_stop": "g", "start": "g", "g at the start": ".2e", "g at the end": ".2e",
        "g of theory": ".2e"}, "stopping_followed")
    for slope in FOLLOWED:
        for share in SHARES:
            for start in STARTS:
                height = share * known[slope]
                profile = profiles.inclined_plane(case.law, "ngf_primitive", amplitude, 1.0, height,
                                                  slope)
                table.row(slope, share, start,
                          *followed(directory, slope, height, start, *options), profile.g.max())
