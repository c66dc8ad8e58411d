"""Every option is documented, and what is not in the tables stops the run before it starts."""

import os
import re
import sys

import pytest
from conftest import ROOT, parameters, pgran, refused, run_ranks

from pgran import cases, cli, options

OPTIONS = [(kind, row) for kind, rows in [("run", options.RUN)] + [
    (f"{part.name} {name}", part.load(name).options) for part in cases.KINDS for name in part.names]
    for row in rows]


@pytest.mark.parametrize("row", [row for _, row in OPTIONS],
                         ids=[f"{kind}-{row.name}" for kind, row in OPTIONS])
def test_every_option_is_documented(row):
    assert row.kind in ("float", "int", "bool", "str", "floats")
    assert len(row.meaning) > 10
    assert row.unit or row.kind != "float" or row.default is not None
    if row.default is not None and row.kind != "str":
        assert row.parse(options.plain(row.default)) == row.default
    assert f"-pgran_{row.name} " in options.help_text([row])


def test_names_that_others_rely_on_are_there():
    assert {row.name for _, row in OPTIONS} >= {
        "case", "model", "law", "mu_s", "mu_2", "b", "A", "phi", "inertial_number", "width",
        "height", "element_size", "shear_modulus", "inertia", "imperfection", "compression",
        "snapshots", "output", "restart"}


@pytest.mark.parametrize("given, message", [
    ({"pgran_heigth": "3"}, "-pgran_heigth 3: no such option; did you mean -pgran_height"),
    ({"pgran_mu_s": "0"}, "-pgran_mu_s 0: allowed is a number > 0"),
    ({"pgran_mu_s": "nan"}, "-pgran_mu_s nan: allowed"),
    ({"pgran_mu_s": "abc"}, "-pgran_mu_s abc: allowed"),
    ({"pgran_phi": "1.5"}, "-pgran_phi 1.5: allowed is a number > 0 and <= 1"),
    ({"pgran_law": "newton"}, "-pgran_law newton: allowed is barker_gray | bingham | jop | "),
    ({"pgran_inertia": "maybe"}, "-pgran_inertia maybe: allowed is true | false"),
    ({"pgran_case": "periodic", "pgran_cell_elements": "2.5"},
     "-pgran_cell_elements 2.5: allowed is an integer >= 2"),
    ({"pgran_cell_elements": "8"}, "-pgran_cell_elements 8: this option belongs to "
     "-pgran_case periodic"),
    ({"pgran_case": "periodic", "pgran_plates_slip": "false"},
     "-pgran_plates_slip false: this option belongs to -pgran_case biaxial"),
    ({"pgran_mu_2": "0.6"}, "-pgran_mu_2 0.6: this option belongs to -pgran_law barker_gray and "
     "-pgran_law jop"),
    ({"pgran_law": "jop", "pgran_I_0": "0.3", "pgran_b": "1"}, "-pgran_I_0 0.3: replaces "
     "-pgran_b"),
    ({"pgran_imperfection": "1", "pgran_imperfection_mirrored": "true"},
     "-pgran_imperfection_mirrored True: there is no imperfection with -pgran_imperfection 1"),
    ({"pgran_mode_amplitude": "0.1"}, "-pgran_mode_amplitude 0.1: means nothing without -pgran_mode_file"),
    ({"pgran_restart_snapshot": "0"}, "-pgran_restart_snapshot 0: means nothing without "
     "-pgran_restart"),
    ({"pgran_step_min": "1"}, "-pgran_step_min 1.0: must lie below -pgran_step_max 0.01"),
    ({"pgran_body_force": "1"}, "-pgran_body_force 1: allowed is 2 numbers"),
    ({"pgran_snapshots": "0.05,1.2"}, "-pgran_snapshots 0.05,1.2: allowed is a list of numbers"),
    ({"pgran_law": "jop", "pgran_mu_2": "0.3"}, "-pgran_mu_2 0.3: must exceed"),
])
def test_bad_input_names_the_option_its_value_and_what_is_allowed(given, message):
    with pytest.raises(cli.REPORTED_ERRORS) as caught:
        cases.read(given)
    assert message in caught.value.as_option()


def test_a_shorter_run_leaves_out_the_snapshots_that_it_does_not_reach():
    def snapshots(**given):
        return parameters(**given).snapshots

    assert snapshots() == (0.1,)
    assert snapshots(snapshots="0.05,0.10", compression="0.02") == (0.02,)
    assert snapshots(snapshots="0.10,0.05", compression="0.14") == (0.05, 0.1, 0.14)
    assert snapshots(snapshots="0.05,0.10") == (0.05, 0.1)
    assert snapshots(snapshots="0.05,0.09999999999999998") == (0.05, 0.1)  # equal but for rounding


@pytest.mark.parametrize("given", [
    {"law": "jop", "snapshots": "0.01,0.05", "inertia": "1", "width": "20"},
    {"law": "jop", "I_0": "0.279"}, {"case": "periodic", "end_time": "0.3", "snapshots": "0.1"},
    {"law": "barker_gray", "model": "li", "alpha": "1.8"}], ids=str)
def test_resolved_options_read_back_the_same(given):
    resolved = parameters(**given)
    assert resolved.height == 3.0 * resolved.width
    assert cases.read(options.written(resolved.text())) == resolved


def test_options_of_an_earlier_file_that_a_part_does_not_have_are_left_out():
    resolved = cases.read({"pgran_law": "bingham", "pgran_mu_2": "0.6"}, stored=True)
    assert not hasattr(resolved, "mu_2")


def test_resolving_options_needs_neither_petsc_nor_mpi():
    code = ("import sys, pgran.cases; pgran.cases.create(pgran.cases.read({})); "
            "sys.exit(any(m in sys.modules for m in ('petsc4py', 'mpi4py', 'h5py')))")
    run_ranks(0, "-c", code)


@pytest.mark.parametrize("arguments, message", [
    (["-pgran_elment_size", "2"], "-pgran_elment_size 2: no such option"),
    (["-pgran_element_size", "7"], "-pgran_width 40: must be an integer multiple"),
    (["-pgran_model", "ig"], "-pgran_model ig: only the linear theory knows this model"),
    (["-pgran_restart", "x.h5"], "-pgran_restart x.h5: there is no such file"),
    (["-options_file", "options/none.opts"], "-options_file options/none.opts: there is no such"),
    (["-ts_type", "euler"], "-ts_type euler: allowed is beuler | pseudo"),
    (["-pgran_output", "/proc/none/x.h5"], "-pgran_output /proc/none/x.h5: "),
    (["-pgran_law", "barker_gray"],
     "-pgran_model ngf: -pgran_law barker_gray has no cooperativity"),
])
def test_bad_runs_stop_on_all_ranks_with_one_message(arguments, message, tmp_path):
    done = run_ranks(2, "-m", "pgran", "-pgran_output", tmp_path / "x.h5", *arguments,
                     limit=60, check=False)
    refused(done, message)
    assert not list(tmp_path.iterdir())


def test_help_is_a_page_that_says_where_the_rest_is():
    text = run_ranks(0, "-m", "pgran", "-help", limit=60).stdout
    assert 15 <= len(text.splitlines()) <= 25
    for word in ("-options_file", "-help all", "-doctor", "docs/options.md", "biaxial", "ngf"):
        assert word in text


@pytest.mark.parametrize("given", [{}, {"case": "periodic", "law": "jop", "model": "li"}], ids=str)
def test_help_prints_the_rows_of_case_law_and_model(given):
    arguments = [text for name, value in given.items() for text in (f"-pgran_{name}", value)]
    text = run_ranks(0, "-m", "pgran", *arguments, "-help", "all", limit=60).stdout
    assert options.help_text(parameters(**given).options) in text


def test_option_tables_of_the_documentation_are_current():
    page = (ROOT / "docs" / "options.md").read_text()
    assert page.endswith(options.markdown(cases.KINDS))


def test_the_command_line_wins_over_the_options_file():
    from pgran.cli import file_first

    assert file_first(["pgran", "-a", "1", "-options_file", "x.opts", "-b"]) == [
        "pgran", "-options_file", "x.opts", "-a", "1", "-b"]
    assert file_first(["pgran", "-options_file"]) == ["pgran", "-options_file"]


def test_too_many_ranks_are_refused(tmp_path):
    done = run_ranks(3, "-m", "pgran", "-pgran_output", tmp_path / "x.h5", "-pgran_width", 2,
                     "-pgran_height", 4, limit=60, check=False)
    assert done.returncode == 1
    assert "3 ranks are too many for 1 x 2 elements" in done.stderr


CASE = """
import numpy as np
from pgran.cases import Case
class Cell(Case):
    shape = 2, 3
    def coordinates(self, i, j):
        return np.array([i, j]) / 2.0
class Lacking(Case):
    def coordinates(self, i, j):
        return np.array([i, j])
class Crooked(Cell):
    shape = 2, 0
"""


@pytest.mark.parametrize("name, message", [
    ("Lacking", "flow.py:Lacking: Lacking misses shape"),
    ("Crooked", "its shape is (2, 0); must be two integers > 0"),
    ("None", "has no class None; it has Cell, Lacking, Crooked"),
    ("np", "np is not a subclass of pgran.cases.Case")])
def test_a_case_that_misses_something_is_told_what_on_one_line(tmp_path, name, message):
    (tmp_path / "flow.py").write_text(CASE)
    done = run_ranks(2, "-m", "pgran", "-pgran_output", tmp_path / "x.h5", "-pgran_case",
                     f"{tmp_path}/flow.py:{name}", limit=60, check=False)
    refused(done, message)
    assert len(done.stderr.split("pgran: error: ")[1].split("\n")[0]) > 10


@pytest.mark.parametrize("text, message", [
    ("none.py:Law", "none.py cannot be imported: FileNotFoundError: there is no such file"),
    ("no_such_package:Law", "cannot be imported: ModuleNotFoundError"),
    ("pgran.material.laws:Law", "Law misses inertial_number, stress_ratio")])
def test_a_law_that_cannot_be_had_is_told_why(text, message):
    with pytest.raises(options.ParameterError) as caught:
        parameters(law=text)
    assert f"-pgran_law {text}: " in caught.value.as_option()
    assert message in caught.value.as_option()


def test_a_case_is_one_new_file(tmp_path):
    """The file alone gives a case its name, its options, and the words of others about them."""
    row = ('from pgran.options import positive\n', '    options = positive("depth", 2.0, "d", '
           '"depth of the layer in which the flow is"),\n')
    text = CASE.replace("    shape = 2, 3\n", "    shape = 2, 3\n" + row[1])
    (tmp_path / "layer.py").write_text(row[0] + text.split("class Lacking")[0])
    code = ("import sys, pgran.cases as c; c.__path__.append(sys.argv[1]); "
            "case = c.create(c.read({'pgran_case': 'layer', 'pgran_depth': '3'})); "
            "assert case.parameters.depth == 3.0 and 'layer' in c.CASES.names\n"
            "try: c.read({'pgran_depth': '3'})\n"
            "except ValueError as error: print(error)")
    told = run_ranks(0, "-c", code, tmp_path).stdout
    assert "this option belongs to -pgran_case layer" in told


@pytest.mark.parametrize("name", ["own_case", "power_law"])
def test_worked_examples_run_from_outside_the_package(tmp_path, name):
    coarse = ("-pgran_element_size", 4) if name == "power_law" else ()
    done = pgran(2, f"{name}.opts", tmp_path / "x.h5", *coarse, limit=120)
    assert "docs/examples/" in done.stdout


def test_the_worked_case_is_in_equilibrium(tmp_path):
    import h5py
    import numpy as np

    path = tmp_path / "x.h5"
    pgran(2, "own_case.opts", path)
    with h5py.File(path) as file:
        stress = file["history/shear_stress"][-1]
        fields = {name: data[...] for name, data in file["snapshots/0000"].items()}
    y = fields["coordinates"][..., 1]
    np.testing.assert_allclose(fields["pressure"], 1.0 + 0.005 * (20.0 - y), rtol=1e-9)
    np.testing.assert_allclose(fields["deviator"][..., 2], stress, rtol=0.01)
    speed = fields["velocity"][..., 0]
    assert speed.min() == 0.0 and speed.max() == pytest.approx(20.0)
    assert (np.diff(speed, axis=0) > 0.0).all() and np.ptp(speed, axis=1).max() < 1e-9
    # The layer above, under less pressure, flows faster: the profile bends upwards.
    assert speed[len(speed) // 2, 0] < 9.0


def test_documented_examples_are_the_files_that_run():
    page = (ROOT / "docs" / "extending.md").read_text()
    for name in ("planar_shear", "power_law"):
        source = (ROOT / "docs" / "examples" / f"{name}.py").read_text()
        body = source[source.index("class "):]
        assert re.sub(r"\s+", " ", body) in re.sub(r"\s+", " ", page)


def test_the_file_of_a_class_is_read_as_it_is_and_leaves_no_bytecode(tmp_path, monkeypatch):
    """Bytecode of an earlier version of the same size and time would be taken for the file."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    path = tmp_path / "law.py"
    found = []
    for slope in "12":
        path.write_text("from pgran.material.laws.bingham import Bingham\n\n\n"
                        f"class Mine(Bingham):\n    slope = {slope}\n")
        os.utime(path, ns=(10**18, 10**18 + int(slope)))  # within one second
        found.append(parameters(law=f"{path}:Mine").part("law").slope)
    assert found == [1, 2]
    assert [entry.name for entry in tmp_path.iterdir()] == ["law.py"]
