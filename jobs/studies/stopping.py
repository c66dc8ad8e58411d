"""Stopping height of a layer on an inclined plane, with dynamic NGF."""

from pathlib import Path

import numpy as np

from pgran import cases
from pgran.theory import profiles

from . import study
from .flows import errors

SLOPES = 22, 23, 24, 25, 26, 28, 30
#: Tolerances of steady flow with a fluidity near zero.
STRICT = "-ts_pseudo_fatol", 1e-13, "-snes_atol", 1e-14, "-snes_rtol", 1e-8
#: Elements across the layer.
ELEMENTS = 24
#: Heights over H_stop of flowing and of static layers.
FLOWING, STATIC = (1.02, 1.04, 1.06, 1.08), (0.95, 1.05)
#: Time for elastic deformation of the static layer, 1/gdot0. The eigenvalue does not depend on
#: it, but rounding errors of a very stiff layer would hide it.
SOFT = 0.01
#: Shear modulus, phi rho_s G d, so large that rotation of the stress does not affect mu.
RIGID = 1e5
#: Relaxation time, 1/gdot0; slopes, heights over H_stop and end (1/gdot0) of transient runs. The
#: rate near H_stop is (A d/xi)^2 (1 - (H_stop/H)^2)/t0, so the end is late.
TIME, FOLLOWED, SHARES, END = 1.0, (24, 28), (0.9, 0.98, 1.02, 1.1), 10000
#: Initial fluidity over the fluidity of the reference flow: almost static, and flowing.
STARTS = 1e-6, 1.0
FILE = "inclined_plane"


def layer(slope, height, *options):
    """Return the options of a layer with dynamic NGF."""
    side = float(height) / ELEMENTS
    return ("-pgran_model", "ngf_primitive", "-pgran_relaxation_time", TIME, "-pgran_slope", slope,
            "-pgran_grading", 2, "-pgran_height", float(height), "-pgran_element_size", side,
            "-pgran_width", 2 * side, *options)


def end_of_flow(directory, slope, known, *options):
    """Return the height, d, of vanishing fluidity in steady flow, and the largest error."""
    largest, error = [], []
    for share in FLOWING:
        path = directory / f"flow_{slope}_{share:g}.h5"
        found = study.run(path, FILE, *layer(slope, share * known), *STRICT, *options)
        largest.append(found.snapshots[-1]["fluidity"].max())
        error.append(errors(path)[0])
    return known * float(np.polyfit(largest, FLOWING, len(FLOWING) - 1)[-1]), max(error)


def zero_of_eigenvalue(directory, slope, known, *options):
    """Return the height, d, at which the leading eigenvalue of the static layer changes its sign.

    The eigenvalue is linear in 1/H^2, so two heights suffice.
    """
    rates = []
    for share in STATIC:
        path = directory / f"rest_{slope}_{share:g}.h5"
        study.run(path, FILE, *layer(slope, share * known), "-ts_type", "beuler",
                  "-pgran_start_fluidity", 0, "-pgran_shear_modulus", RIGID, "-pgran_end_time", 1,
                  *options)
        rates.append(study.json_of(1, "pgran.eigen", "-pgran_restart", path, "-json",
                                   "-pgran_steady_time", SOFT)[0]["computed"])
    return known / float(np.sqrt(np.interp(0.0, rates, [share**-2 for share in STATIC])))


def transient(directory, slope, height, start, *options):
    """Return the largest fluidity at the start and at the end of a transient run."""
    found = study.run(
        directory / f"time_{slope}_{height:.3f}_{start:g}.h5", FILE, *layer(slope, height),
        "-ts_type", "beuler", "-ts_max_steps", 100000, "-pgran_shear_modulus", RIGID,
        "-pgran_start_fluidity", start, "-pgran_step_max", 20, "-pgran_end_time", END,
        "-pgran_rest_speed", 0, "-pgran_snapshots", 1e-3, *options)
    return [snapshot["fluidity"].max() for snapshot in found.snapshots[:2]]


def stopping(directory="results/stopping", *, options=()):
    """Stopping height on an inclined plane with dynamic NGF: stopping [directory]

    H_stop over the slope in three ways: the analytical result (pi/2) xi(mu); the height at which
    the fluidity of steady flow vanishes; and the height at which the leading eigenvalue of the
    static layer changes its sign. The second table contains transient runs of layers thinner and
    thicker than H_stop that start almost static and flowing. Three minutes on two cores.
    """
    directory = Path(directory)
    case = cases.create(study.parameters(FILE, *layer(SLOPES[0], 10.0)))
    A = case.parameters.A

    def heights():
        for slope in SLOPES:
            known = profiles.stopping_height(case.law, A, slope)
            end, error = end_of_flow(directory, slope, known, *options)
            zero = zero_of_eigenvalue(directory, slope, known, *options)
            yield slope, known, end, end / known - 1.0, zero, zero / known - 1.0, error

    def layers():
        for slope in FOLLOWED:
            for share in SHARES:
                height = share * profiles.stopping_height(case.law, A, slope)
                profile = profiles.inclined_plane(case.law, "ngf_primitive", A, 1.0, height, slope)
                for start in STARTS:
                    yield (slope, share, start, *transient(directory, slope, height, start,
                                                           *options), profile.g.max())

    study.write_table(directory / "stopping.csv", {
        "slope": "g", "analytical (d)": ".5f", "end of flow (d)": ".5f", "difference": ".1e",
        "zero of the eigenvalue (d)": ".5f", "difference ": ".1e", "error of velocity": ".1e"},
        heights())
    study.write_table(directory / "stopping_followed.csv", {
        "slope": "g", "H/H_stop": "g", "start": "g", "g at the start": ".2e", "g at the end": ".2e",
        "g, analytical": ".2e"}, layers())
