"""Every option is documented, and what is not in the table stops the run before it starts."""

import pytest
from conftest import ROOT, run_ranks

from pgran import options


@pytest.mark.parametrize("option", options.TABLE, ids=lambda option: option.name)
def test_every_option_is_documented(option):
    assert option.kind in ("float", "int", "bool", "str", "floats")
    assert len(option.meaning) > 10
    assert option.unit or option.kind != "float" or option.default is not None
    if option.default is not None and option.kind != "str":
        assert option.parse(options._plain(option.default)) == option.default
    assert f"-pgran_{option.name} " in options.help_text()


def test_names_that_others_rely_on_are_there():
    names = {option.name for option in options.TABLE}
    assert names >= {"case", "model", "law", "mu_s", "mu_2", "b", "A", "phi", "inertial_number",
                     "width", "height", "element_size", "shear_modulus", "inertia",
                     "imperfection", "compression", "snapshots", "output", "restart"}


@pytest.mark.parametrize("given, message", [
    ({"pgran_heigth": "3"}, "-pgran_heigth 3: no such option; did you mean -pgran_height"),
    ({"pgran_mu_s": "0"}, "-pgran_mu_s 0: allowed is a number > 0"),
    ({"pgran_mu_s": "nan"}, "-pgran_mu_s nan: allowed"),
    ({"pgran_mu_s": "abc"}, "-pgran_mu_s abc: allowed"),
    ({"pgran_phi": "1.5"}, "-pgran_phi 1.5: allowed is a number > 0 and <= 1"),
    ({"pgran_law": "newton"}, "-pgran_law newton: allowed is bingham | jop"),
    ({"pgran_inertia": "maybe"}, "-pgran_inertia maybe: allowed is true | false"),
    ({"pgran_cell_elements": "2.5"}, "-pgran_cell_elements 2.5: allowed is an integer >= 1"),
    ({"pgran_body_force": "1"}, "-pgran_body_force 1: allowed is 2 numbers"),
    ({"pgran_snapshots": "0.05,1.2"}, "-pgran_snapshots 0.05,1.2: allowed is a list of numbers"),
    ({"pgran_law": "jop", "pgran_mu_2": "0.3"}, "-pgran_mu_2 0.3: must exceed"),
])
def test_bad_input_names_the_option_its_value_and_what_is_allowed(given, message):
    with pytest.raises(options.OptionError) as caught:
        options.read(given)
    assert message in str(caught.value)


def test_a_shorter_run_leaves_out_the_snapshots_that_it_does_not_reach():
    def snapshots(**given):
        return options.read({f"pgran_{key}": text for key, text in given.items()}).snapshots

    assert snapshots() == (0.1,)
    assert snapshots(snapshots="0.05,0.10", compression="0.02") == (0.02,)
    assert snapshots(snapshots="0.10,0.05", compression="0.14") == (0.05, 0.1, 0.14)
    assert snapshots(snapshots="0.05,0.10") == (0.05, 0.1)


def test_resolved_options_read_back_the_same():
    settings = options.read({"pgran_law": "jop", "pgran_snapshots": "0.01,0.05",
                             "pgran_inertia": "1", "pgran_width": "20"})
    assert settings.height == 60.0
    pairs = [line[1:].split(" ", 1) for line in settings.text().splitlines()]
    assert options.read(dict(pairs)) == settings


def test_options_module_needs_neither_petsc_nor_mpi():
    code = ("import sys, pgran.options, pgran.rheology; "
            "sys.exit(any(m in sys.modules for m in ('petsc4py', 'mpi4py')))")
    run_ranks(0, "-c", code)


@pytest.mark.parametrize("arguments, message", [
    (["-pgran_elment_size", "2"], "-pgran_elment_size 2: no such option"),
    (["-pgran_element_size", "7"], "-pgran_width 40: must be a whole multiple"),
    (["-pgran_model", "ig"], "-pgran_model ig: known to the linear theory alone"),
    (["-pgran_restart", "x.h5"], "-pgran_restart x.h5: allowed with -ts_type pseudo"),
    (["-options_file", "options/none.opts"], "-options_file options/none.opts: there is no such"),
    (["-ts_type", "euler"], "-ts_type euler: allowed is beuler | pseudo"),
    (["-pgran_output", "/proc/none/x.h5"], "-pgran_output /proc/none/x.h5: "),
])
def test_bad_runs_stop_on_all_ranks_with_one_message(arguments, message, tmp_path):
    done = run_ranks(2, "-m", "pgran", "-pgran_output", tmp_path / "x.h5", *arguments,
                     limit=60, check=False)
    assert done.returncode == 1
    assert done.stderr.count("pgran: error: ") == 1
    assert message in done.stderr
    assert not list(tmp_path.iterdir())


def test_help_prints_the_table():
    text = run_ranks(0, "-m", "pgran", "-help", limit=60).stdout
    assert options.help_text() in text


def test_options_table_of_the_readme_is_current():
    assert options.markdown_table() in (ROOT / "README.md").read_text()


def test_the_command_line_wins_over_the_options_file():
    from pgran.__main__ import file_first

    assert file_first(["pgran", "-a", "1", "-options_file", "x.opts", "-b"]) == [
        "pgran", "-options_file", "x.opts", "-a", "1", "-b"]
    assert file_first(["pgran", "-options_file"]) == ["pgran", "-options_file"]


def test_too_many_ranks_are_refused(tmp_path):
    done = run_ranks(3, "-m", "pgran", "-pgran_output", tmp_path / "x.h5", "-pgran_width", 2,
                     "-pgran_height", 4, limit=60, check=False)
    assert done.returncode == 1
    assert "3 ranks are too many for 1 x 2 elements" in done.stderr


def test_a_case_is_one_new_file(tmp_path):
    code = ("import pathlib, sys, pgran; "
            "root = pathlib.Path(sys.argv[1]); "
            "import pgran.options as o; print(o.CASES)")
    assert run_ranks(0, "-c", code, tmp_path).stdout.strip() == str(
        tuple(sorted(p.stem for p in (ROOT / "pgran/cases").glob("*.py") if p.stem[0] != "_")))
