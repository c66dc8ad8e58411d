"""Options are documented, resolved and checked; user-defined classes are loaded from files."""

import os
import re
import sys

import numpy as np
import pytest
from conftest import ROOT, parameters, pgran, run_ranks

from pgran import cases, cli, options
from pgran.options.files import combined_options, default_solver, read_file, shipped
from pgran.output.result import Result

OPTIONS = [(kind, option) for kind, group in [("run", options.RUN)] + [
    (f"{part.name} {name}", part.load(name).options) for part in cases.KINDS for name in part.names]
    for option in group]


REFERENCE = "".join(page.read_text() for page in (ROOT / "docs").rglob("options.md"))


@pytest.mark.parametrize("option", [option for _, option in OPTIONS],
                         ids=[f"{kind}-{option.name}" for kind, option in OPTIONS])
def test_every_option_is_documented(option):
    assert len(option.meaning) > 10
    assert option.unit or option.kind != "float" or option.default is not None
    if option.default is not None and option.kind != "str":
        assert option.parse(options.plain(option.default)) == option.default
    assert f"-pgran_{option.name} " in options.help_text([option])
    assert f"`-pgran_{option.name}`" in REFERENCE


@pytest.mark.parametrize("given, message", [
    ({"heigth": "3"}, "unknown option -pgran_heigth; did you mean -pgran_height"),
    ({"mu_s": "0"}, "-pgran_mu_s 0: must be a number > 0"),
    ({"mu_s": "nan"}, "-pgran_mu_s nan: must be"), ({"law": "nosuch"}, "-pgran_law nosuch: exp"),
    ({"checkpoint_steps": "9" * 400}, ": must be an integer >= 1"),
    ({"phi": "1.5"}, "-pgran_phi 1.5: must be a number > 0 and <= 1"),
    ({"law": "newton"}, "-pgran_law newton: expected one of: barker_gray | bingham | jop | "),
    ({"inertia": "maybe"}, "-pgran_inertia maybe: expected one of: true | false"),
    ({"mu_2": "0.6"},
     "-pgran_mu_2 0.6: this option belongs to -pgran_law barker_gray and -pgran_law jop"),
    ({"law": "jop", "I_0": "0.3", "b": "1"}, "-pgran_I_0 0.3: "),
    ({"imperfection": "1", "imperfection_mirrored": "true"}, "-pgran_imperfection_mirrored True: "),
    ({"mode_amplitude": "0.1"}, "-pgran_mode_amplitude 0.1: requires -pgran_mode_file"),
    ({"step_min": "1"}, "-pgran_step_min 1.0: must be < -pgran_step_max 0.01"),
    ({"step_first": "1e-9"}, "-pgran_step_first 1e-09: must be >= -pgran_step_min"),
    ({"body_force": "1"}, "-pgran_body_force 1: must be 2 numbers"),
    ({"snapshots": "0.05,1.2"}, "-pgran_snapshots 0.05,1.2: must be a list of numbers"),
    ({"inertial_number": "10"}, "-pgran_inertial_number 10"),
    ({"output": "x.xdmf"}, "-pgran_output x.xdmf: must be a file name that ends in .h5"),
    ({"imperfection_size": "80"}, "-pgran_imperfection_size 80"),
    ({"seed": "x.h5"}, "unknown option -pgran_seed; it is now -pgran_mode_file"),
    ({"assembly": "x"}, "unknown option -pgran_assembly; it was removed"),
    ({"law": "no_such_package:Law"}, "cannot be imported: ModuleNotFoundError"),
    ({"law": "pgran.material.laws:Law"}, "Law lacks inertial_number, stress_ratio"),
], ids=str)
def test_an_error_in_the_options_names_option_value_and_allowed_values(given, message):
    with pytest.raises(cli.REPORTED_ERRORS) as caught:
        cases.create(parameters(**given))
    assert message in caught.value.as_option()


@pytest.mark.parametrize("old, new", options.RENAMED.items())
def test_old_names_are_accepted_in_stored_options_only(old, new):
    text = {"mode_file": "mode.h5", "secant": "false"}.get(new, "0.001")
    with pytest.raises(options.OptionError, match=f"now -pgran_{new}" if new else "was removed"):
        parameters(**{old: text})
    for texts in ({f"pgran_{old}": text}, options.written(
            f"-pgran_step_perturbation 0.001\n-pgran_{old} {text}\n")):
        found = cases.read(texts, stored=True)
        assert not hasattr(found, old)
        assert new is None or options.plain(getattr(found, new)) == text
    foreign = cases.read({"pgran_law": "bingham", "pgran_mu_2": "0.6"}, stored=True)
    assert not hasattr(foreign, "mu_2")


def test_a_shorter_run_omits_snapshots_after_its_end():
    def snapshots(**given):
        return parameters(**given).snapshots

    assert snapshots() == (0.1,)
    assert snapshots(snapshots="0.05,0.10", compression="0.02") == (0.02,)
    assert snapshots(snapshots="0.10,0.05", compression="0.14") == (0.05, 0.1, 0.14)
    assert snapshots(snapshots="0.05,0.09999999999999998") == (0.05, 0.1)  # equal but for rounding


@pytest.mark.parametrize("given", [
    {"law": "jop", "snapshots": "0.01,0.05", "inertia": "1", "width": "20"},
    {"law": "jop", "I_0": "0.279"}, {"case": "periodic", "end_time": "0.3", "snapshots": "0.1"},
    {"law": "barker_gray", "model": "li", "alpha": "1.8"}], ids=str)
def test_resolved_options_can_be_written_and_read(given):
    resolved = parameters(**given)
    assert resolved.height == 3.0 * resolved.width
    assert cases.read(options.written(resolved.text())) == resolved


def test_options_are_resolved_without_petsc_and_mpi():
    code = ("import sys, pgran.cases; pgran.cases.create(pgran.cases.read({})); "
            "sys.exit(any(m in sys.modules for m in ('petsc4py', 'mpi4py', 'h5py')))")
    run_ranks(0, "-c", code)


def test_options_files_include_others_and_the_command_line_overrides_them(tmp_path):
    (tmp_path / "flow.opts").write_text("-pgran_width 8  # d\n-options_file solver.opts\n-b\n")
    (tmp_path / "solver.opts").write_text("-pgran_width 4\n-snes_atol 1e-3\n")
    found = combined_options(tmp_path / "flow.opts", "-snes_atol", "-1", "-c")
    assert found == {"pgran_width": "4", "snes_atol": "-1", "b": "", "c": ""}


def test_the_default_solver_suits_the_flow():
    def solver(**given):
        path, texts = default_solver({f"pgran_{name}" if name != "ts_type" else name: text
                                      for name, text in given.items()})
        return path.stem, texts

    direct = read_file(shipped("solver_lu"))
    assert solver(model="li") == ("solver_lu", direct) == solver(case="x.py:Case")
    assert solver()[0] == solver(model="ngf_primitive")[0] == "biaxial"
    assert solver()[1]["pgran_tolerance_full_deviation"] == "1"
    assert solver(ts_type="pseudo")[0] == "steady"
    name, texts = solver(case="planar_shear", ts_type="pseudo", model="li")
    assert name == "planar_shear" and texts["ts_max_steps"] == "200" and "ts_type" not in texts
    assert default_solver({"pc_type": "lu"}) == (None, {}) and shipped("nosuch") is None


def test_help_lists_the_options_of_case_law_and_model():
    given = "-pgran_case", "periodic", "-pgran_law", "jop", "-pgran_model", "li"
    text = run_ranks(0, "-m", "pgran", *given, "-help", "all").stdout
    found = parameters(case="periodic", law="jop", model="li").options
    assert options.help_text(found) in text


def test_a_new_module_gives_a_case_its_name_and_its_options(tmp_path, monkeypatch):
    (tmp_path / "layer.py").write_text("""
from pgran.cases.biaxial import Biaxial
from pgran.options import positive
class Layer(Biaxial):
    options = *Biaxial.options, positive("depth", 2.0, "d", "depth of the layer")
""")
    monkeypatch.setattr(cases, "__path__", [*cases.__path__, str(tmp_path)])
    assert parameters(case="layer", depth=3).depth == 3.0 and "layer" in cases.CASES.names
    with pytest.raises(options.OptionError, match="this option belongs to -pgran_case layer"):
        parameters(depth=3)


def test_the_example_of_a_user_defined_case_is_in_equilibrium(path):
    pgran(2, "own_case.opts", path)
    result = Result(path)
    fields, stress = result.snapshots[0], result.history["shear_stress"][-1]
    np.testing.assert_allclose(fields["pressure"], 1.0 + 0.005 * (20.0 - fields.x[..., 1]),
                               rtol=1e-9)
    np.testing.assert_allclose(fields["deviator"][..., 2], stress, rtol=0.01)
    speed = fields["velocity"][..., 0]
    assert speed.min() == 0.0 and speed.max() == pytest.approx(20.0)
    assert (np.diff(speed, axis=0) > 0.0).all() and np.ptp(speed, axis=1).max() < 1e-9
    # The upper layers are under less pressure and flow faster.
    assert speed[len(speed) // 2, 0] < 9.0


def test_documented_examples_are_the_files_that_run():
    pages = "".join(page.read_text() for page in (ROOT / "docs").rglob("*.md"))
    for name in ("planar_shear", "power_law"):
        source = (ROOT / "docs" / "examples" / f"{name}.py").read_text()
        body = source[source.index("class "):]
        assert re.sub(r"\s+", " ", body) in re.sub(r"\s+", " ", pages)


def test_a_changed_user_defined_file_is_read_again_and_leaves_no_bytecode(tmp_path, monkeypatch):
    """Bytecode of an earlier version of the same size and time would be used instead."""
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
