"""Invariance under partition, mirroring, units and rotation, and conservation laws."""

import re

import numpy as np
import pytest
from conftest import ROOT, discretised, pgran, run_ranks
from scipy.integrate import trapezoid
from test_runs import differences, snapshot

from pgran.output.result import Result
from pgran.solve.state import State, TimeStep
from studies.kill import SCALE_OF

SMALL = "-pgran_element_size", 8, "-pgran_progress", "quiet", "-pgran_compression", 0.01


@pytest.fixture(scope="module")
def direct(tmp_path_factory):
    """A run on one rank with a direct solver."""
    path = tmp_path_factory.mktemp("direct") / "direct.h5"
    pgran(0, "direct.opts", path, *SMALL)
    return path


PARTITION = """
import sys
import numpy as np
import petsc4py
start = petsc4py.init
def init(*arguments):
    start(*arguments)
    from pgran.space.grid import Grid
    Grid._partition = lambda self: [np.array([2, 2, 1]), np.array([15])]
petsc4py.init = init
from pgran.__main__ import main
sys.exit(main(sys.argv))
"""


def test_the_result_does_not_depend_on_the_partition(direct, tmp_path):
    path = tmp_path / "run.h5"
    run_ranks(3, "-c", PARTITION, "-options_file", ROOT / "options" / "direct.opts", *SMALL,
              "-pgran_output", path)
    assert all(difference < 1e-7 for difference in differences(path, direct).values())


def test_a_mirrored_problem_has_the_mirrored_result(tmp_path):
    """The pinned corner remains on the left, which shifts the result along x1."""
    paths = [tmp_path / f"{name}.h5" for name in ("original", "mirrored")]
    for path, mirrored in zip(paths, ("false", "true")):  # with the same steps
        pgran(0, "direct.opts", path, *SMALL, "-pgran_imperfection_mirrored", mirrored,
              "-pgran_step_error", 1e9, "-pgran_step_max", 5e-4)
    (_, a), (_, b) = map(snapshot, paths)
    assert a["inertial_number"].max() > 1.2e-3  # a band has formed
    signs = {"inertial_number": 1.0, "pressure": 1.0, "fluidity": 1.0, "stress_ratio": 1.0,
             "deviator": [1.0, 1.0, -1.0], "velocity": [-1.0, 1.0], "coordinates": [-1.0, 1.0]}
    for name, sign in signs.items():
        mirrored = b[name][:, ::-1] * sign
        if name in ("velocity", "coordinates"):
            mirrored[..., 0] -= (mirrored - a[name])[..., 0].mean()
        np.testing.assert_allclose(mirrored, a[name], rtol=0.0,
                                   atol=1e-7 * np.abs(a[name]).max(), err_msg=name)


UNIT = 2.5e4
#: The specimen with stresses in Pa and |sigma_1| = 2.5e4 Pa.
PASCAL = f"""
from pgran.cases import pressure
from pgran.cases.biaxial import Biaxial

class Pascal(Biaxial):
    options = Biaxial.options
    stress_unit = "Pa"
    pressure = property(lambda self: {UNIT} * super().pressure)

    def tractions(self, time):
        return {{"left": pressure({UNIT}), "right": pressure({UNIT})}}

    def start(self, x):
        velocity, fluidity, pressures = super().start(x)
        return velocity, fluidity, {UNIT} * pressures
"""


def test_the_stress_unit_does_not_change_the_result(tmp_path):
    (tmp_path / "pascal.py").write_text(PASCAL)
    original, path = (tmp_path / f"{name}.h5" for name in ("original", "pascal"))
    # The residual norm has a unit: Newton's method continues to rounding error in both runs.
    strict = "-snes_rtol", 1e-30, "-snes_max_it", 20, "-snes_atol"
    pgran(0, "direct.opts", original, *SMALL, *strict, 1e-10)
    pgran(0, "direct.opts", path, *SMALL, "-pgran_case", f"{tmp_path / 'pascal.py'}:Pascal",
          "-pgran_shear_modulus", 1000 * UNIT, *strict, 1e-7)
    (_, found), (_, fields) = snapshot(path), snapshot(original)
    for name, values in fields.items():
        unit = UNIT if name in ("pressure", "deviator", "stress_tensor") else 1.0
        scale = np.abs(fields[SCALE_OF.get(name, name)]).max()
        np.testing.assert_allclose(found[name] / unit, values, rtol=0.0, atol=1e-6 * scale,
                                   err_msg=name)
    found, work = (Result(file).history["work"] for file in (path, original))
    np.testing.assert_allclose(found / UNIT, work, rtol=1e-6, atol=1e-9)


def test_scales_of_the_output_do_not_change_the_result(direct, tmp_path):
    path = tmp_path / "si.h5"
    pgran(0, "direct.opts", path, *SMALL, "-pgran_grain_diameter", 5e-4, "-pgran_grain_density",
          2600, "-pgran_lateral_stress", 5e4)
    assert not any(differences(path, direct).values())


def test_a_rigid_rotation_rotates_the_stress_with_the_material(angle=3.0):
    """The invariants of an elastic deviator are constant, and its axes rotate by the angle."""
    form = discretised(element_size=20, width=40, height=40, model="li", imperfection=1)
    first = form.kinematics.mandel(
        form.no_stress() + np.array([0.05, -0.05, 0.02]).reshape(-1, 1, 1))
    x = form.case.coordinates(*form.grid.nodes.index)

    def unknowns(at):
        return form.grid.join([20.0 - at[1], at[0] - 20.0], None, 1.6)

    form.held[:] = True
    form.prescribed = lambda time: np.full(form.grid.n_local, np.nan)
    errors = []
    for n in (120, 240):
        dt = angle / n
        state = State(0.0, x, unknowns(x), first.copy())
        for _ in range(n):
            step = TimeStep(form, state, dt)
            local = unknowns(step.increment.x)
            step.increment.prescribed = local
            state = step.end(local, form.stress(local, step.increment))
        cos, sin = np.cos(2.0 * angle), np.sin(2.0 * angle)
        turned = [0.05 * cos - 0.02 * sin, -0.05 * cos + 0.02 * sin, 0.05 * sin + 0.02 * cos]
        stress = form.kinematics.tensor(state.stress)
        errors.append(max(np.abs(part - value).max() for part, value in zip(stress, turned)))
        size = np.hypot(stress[0], stress[2])
        np.testing.assert_allclose(size, np.hypot(0.05, 0.02), rtol=2e-3)
    assert errors[1] < 1e-4 and errors[0] / errors[1] > 3.0, errors  # second order in the step


def test_energy_and_volume_are_conserved(tmp_path):
    """Up to 14 %: energy to 1 % from 0.1 % on, to 0.1 % from 1 % on, and volume to 1e-5."""
    path = tmp_path / "run.h5"
    pgran(0, "biaxial.opts", path, "-pgran_element_size", 4, "-pgran_compression", 0.14,
          "-pgran_snapshots", ",".join(f"{c / 100:g}" for c in range(1, 15)))
    result = Result(path)
    found = result.history
    for start, maximum in ((1e-3, 1e-2), (1e-2, 1e-3)):
        assert np.abs(found["energy_error"][found["compression"] > start]).max() < maximum
    assert np.abs(found["volume"] / 4800.0 - 1.0).max() < 1e-5
    # Work of the plate and of the unit pressure on the faces, at constant volume.
    at = [0.0, *(snapshot.attributes["compression"] for snapshot in result.snapshots)]
    widths = [40.0, *(np.ptp(snapshot.x[-1, :, 0]) for snapshot in result.snapshots)]
    force = np.interp(found["compression"], at, widths) * (-found["top_stress"] - 1.0)
    expected = trapezoid(force, 120.0 * found["compression"])
    assert found["work"][-1] - found["work"][0] == pytest.approx(expected, rel=5e-3)


def test_memory_and_petsc_objects_do_not_grow_in_a_thousand_steps(tmp_path):
    alive, memory = [], []
    for steps in (100, 1000):
        log, path = tmp_path / f"{steps}.log", tmp_path / f"{steps}.h5"
        pgran(0, "direct.opts", path, "-pgran_width", 40, "-pgran_height", 40,
              "-pgran_element_size", 20, "-pgran_step_max", 5e-5, "-pgran_progress", "quiet",
              "-pgran_compression", 0.1, "-ts_max_steps", steps, "-log_view", f":{log}")
        result = Result(path)
        assert len(result.history["time"]) == steps
        memory.append(result.attributes["memory"])
        rows = re.findall(r"^ +([A-Z][\w ]+?) +(\d+) +(\d+)", log.read_text().split(
            "Object Type")[1], re.MULTILINE)
        created, destroyed = (sum(int(row[k]) for row in rows) for k in (1, 2))
        assert created > 50, rows
        alive.append(created - destroyed)
    assert alive[0] == alive[1], alive
    assert memory[1] - memory[0] < 10.0, memory
