"""Wrong input of any kind gets one message that names cause and cure, and leaves files alone."""

import os
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from conftest import ROOT, fork_server

from pgran import cases, options

DIRECT = "-options_file", str(ROOT / "options" / "direct.opts")
COARSE = "-pgran_element_size", "8"
#: What makes a run refuse what nothing has read, which it knows after a step, without a new file.
LAST = "-pgran_element_size", "20"


@pytest.fixture
def server(monkeypatch):
    """Run a command of pgran in a folder, with some variables of the environment."""
    def run(module, arguments, folder, **environment):
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        done = fork_server().run(f"pgran.{module}", *arguments, folder=folder, limit=10)
        return SimpleNamespace(code=done.returncode, output=done.stdout, errors=done.stderr)

    return run


def result(path, coordinates=(5, 5, 2), I=(5, 5), dtype="f8", text="-pgran_width 8\n",
           **attributes):
    """Make a file that resembles a result."""
    with h5py.File(path, "w") as file:
        if text is not None:
            file.attrs["options"] = text
        for name, value in attributes.items():
            file.attrs[name] = value
        group = file.create_group("snapshots/0000")
        group.attrs["label"] = "now"
        if coordinates:
            y, x = np.mgrid[:coordinates[0], :coordinates[1]].astype(float)
            group["coordinates"] = np.stack([x, y, x][:coordinates[2]], axis=-1)
        group.create_dataset("inertial_number", data=np.ones(I, dtype=dtype))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with an earlier result and with files of many wrong kinds."""
    folder = tmp_path_factory.mktemp("input")
    result(folder / "keep.h5", run="one", text="-pgran_width 8\n-pgran_element_size 8\n"
           "-pgran_height 24\n")
    (folder / "text.h5").write_text("no HDF5\n")
    (folder / "empty.h5").write_bytes(b"")
    whole = (folder / "keep.h5").read_bytes()
    (folder / "truncated.h5").write_bytes(whole[:len(whole) // 2])
    with h5py.File(folder / "other.h5", "w") as file:
        file["data"] = np.arange(3)
    with h5py.File(folder / "data.h5", "w") as file:
        file["snapshots"] = np.arange(3)
    with h5py.File(folder / "nothing.h5", "w") as file:
        file.create_group("snapshots")
        file.attrs["options"] = ""
    result(folder / "flat.h5", coordinates=(5, 5, 1))
    result(folder / "lost.h5", coordinates=None)
    result(folder / "odd.h5", I=(4, 5))
    result(folder / "words.h5", dtype="S3")
    result(folder / "strange.h5", text="-pgran_mu_s many\n-pgran_nosuch 1\n")
    result(folder / "untold.h5", text=None)
    result(folder / "mute.h5", text="neither this nor that\nx\n")
    os.mkfifo(folder / "pipe.h5")
    (folder / "folder.h5").mkdir()
    (folder / "none.opts").write_text("-options_file missing.opts\n")
    (folder / "self.opts").write_text("-options_file self.opts\n")
    (folder / "binary.opts").write_bytes(bytes(range(256)))
    (folder / "two.opts").write_text("-pgran_width 40 -pgran_height 80\n")
    (folder / "bare.opts").write_text("pgran_width 40\n")
    (folder / "dashes.opts").write_text("--pgran_width 40\n")
    (folder / "quote.opts").write_text('-pgran_width "40\n')
    (folder / "long.opts").write_text("-pgran_width 40 " * 200000)
    (folder / "home").mkdir()
    (folder / "home" / ".petscrc").write_text("-pgran_width 40\nneither this nor that\n")
    (folder / "misspelt.opts").write_text("-pgran_widht 40\n")
    (folder / "law.py").write_text("raise RuntimeError('this law is not ready')\n")
    (folder / "leave.py").write_text("import sys\nsys.exit(0)\n")
    (folder / "shape.py").write_text(
        "from pgran.cases import Case\nclass A(Case):\n    shape = 2, -1\n"
        "    def coordinates(self, i, j):\n        return i, j\n")
    return folder


def below(row):
    """A text that a row does not accept, and that is as near as its kind allows."""
    if row.kind in ("float", "floats", "int", "ints") and row.low > -np.inf:
        return f"{row.low if row.open_low else row.low - 1:g}"
    return {"float": "nan", "floats": "1,inf", "int": "1.5", "ints": "1.5", "bool": "maybe",
            "str": "nosuch"}[row.kind]


def rows():
    """Every row of every part once, with the options that bring the part along."""
    seen = set()
    parts = [((), options.RUN)] + [
        ((f"-pgran_{kind.name}", name), kind.load(name).options)
        for kind in cases.KINDS for name in kind.names]
    for given, found in parts:
        for row in found:
            if (row.name, row.allowed) in seen or (row.kind == "str" and not (
                    row.choices or row.words or row.suffix)):
                continue
            seen.add((row.name, row.allowed))
            yield given, row


#: Arguments of `python -m pgran`, and what the message must say.
RUNS = {
    # words
    "bare word": (["nosuch"], "nosuch: not an option"),
    "word after a value": (["-pgran_width", "40", "80"], "80: not an option"),
    "two dashes": (["--pgran_width", "40"], "--pgran_width: options begin with one dash"),
    "two dashes, file": (["--options_file", "two.opts"], "as in -options_file"),
    "letters swapped": (["-prgan_mu_s", "0.4"], "did you mean -pgran_mu_s?"),
    "dashes inside": (["-pgran-mu-s", "0.4"], "did you mean -pgran_mu_s?"),
    "no prefix": (["-mu_s", "0.4"], "did you mean -pgran_mu_s?"),
    "letter missing": (["-pgran_widh", "40"], "did you mean -pgran_width"),
    "case's own": (["-pgran_cell_elements", "4"], "belongs to -pgran_case periodic"),
    "law's own": (["-pgran_mu_2", "0.6"], "belongs to -pgran_law"),
    "misspelt head": (["-sness_rtol", "1"], "did you mean -snes_rtol?"),
    "misspelt ksp": (["-kspp_type", "lu"], "did you mean -ksp_type?"),
    "misspelt name": (["-snes_rtoll", "1"], "-snes_rtoll 1: no such option; did you mean"),
    "value missing": (["-pgran_width", "-pgran_height", "80"], "-pgran_width"),
    "equals sign": (["-options_file=two.opts"], "a blank divides name and value, as in "
                    "-options_file two.opts"),
    "misspelt file": (["-options_flie", "two.opts"], "did you mean -options_file?"),
    "dash in file": (["-options-file", "two.opts"], "did you mean -options_file?"),
    "file in one word": (["-optionsfile", "two.opts"], "did you mean -options_file?"),
    "log": ([*DIRECT, *LAST, "-log_viwe"], "-log_viwe: no such option; did you mean -log_view?"),
    # options files
    "YAML": (["-options_file_yaml", "two.opts"], "options are not read from YAML; -options_file"),
    "no line ends": (["-options_file", "long.opts"], "long.opts, line 1: it has 3200000"),
    "no file": (["-options_file", "nosuch.opts"], "nosuch.opts: there is no such file"),
    "file not named": (["-options_file"], "the name of a file is missing"),
    "folder as file": (["-options_file", "folder.h5"], "cannot be read as text"),
    "nested file missing": (["-options_file", "none.opts"], "missing.opts: there is no such file"),
    "file names itself": (["-options_file", "self.opts"], "it names itself"),
    "binary file": (["-options_file", "binary.opts"], "cannot be read as text"),
    "HDF5 as file": (["-options_file", "keep.h5"], "cannot be read as text"),
    "two on a line": (["-options_file", "two.opts"], "two.opts, line 1: "),
    "word in a file": (["-options_file", "bare.opts"], "pgran_width is no option"),
    "dashes in a file": (["-options_file", "dashes.opts"], "--pgran_width is no option"),
    "open quote": (["-options_file", "quote.opts"], "quote.opts, line 1: no closing quotation"),
    "misspelt in a file": (["-options_file", "misspelt.opts"], "did you mean -pgran_width"),
    # combinations
    "does not divide": (["-pgran_element_size", "7"], "-pgran_width 40: must be a whole multiple"),
    "steady inertia": (["-pgran_inertia", "true", "-ts_type", "pseudo"], "-pgran_inertia true"),
    "theory's model": (["-pgran_model", "ig"], "only the linear theory knows this model"),
    "law without length": (["-pgran_law", "barker_gray"], "no cooperativity length"),
    "both b and I_0": (["-pgran_law", "jop", "-pgran_b", "1", "-pgran_I_0", "1"], "-pgran_I_0"),
    "mu_2 below mu_s": (["-pgran_law", "jop", "-pgran_mu_2", "0.3"], "must exceed"),
    "I0 too fast": (["-pgran_inertial_number", "10"], "-pgran_inertial_number 10"),
    "square too large": (["-pgran_imperfection_size", "80"], "-pgran_imperfection_size 80"),
    "no square": (["-pgran_imperfection", "1", "-pgran_imperfection_mirrored", "1"],
                  "there is no weak square"),
    "size without seed": (["-pgran_mode_amplitude", "1"], "means nothing without -pgran_mode_file"),
    "snapshot without restart": (["-pgran_restart_snapshot", "1"], "means nothing without"),
    "steps the wrong way": (["-pgran_step_min", "1"], "must lie below -pgran_step_max"),
    "first step too small": (["-pgran_step_first", "1e-9"], "-pgran_step_first 1e-09"),
    "too stiff": (["-pgran_shear_modulus", "1e9"], "-pgran_step_min 1e-08: the first step"),
    "targets too close": (["-pgran_snapshots", "0.05,0.0500000001"], "two times to reach"),
    "too many elements": (["-pgran_element_size", "1e-3"], "more than the indices"),
    "more than memory": (["-pgran_element_size", "0.01"], "GB a rank"),
    "overflow": (["-pgran_width", "1e300"], "-pgran_width 1e+300: makes"),
    "overflow of both": (["-pgran_width", "1e200", "-pgran_element_size", "1e-200"],
                         "-pgran_width 1e+200"),
    **{f"too large, {' '.join(given)}": (given, f"{' '.join(given[-2:])}: too large or too small")
       for given in (["-pgran_A", "1e300"], ["-pgran_law", "jop", "-pgran_mu_2", "1e300"],
                     ["-pgran_case", "annular_shear", "-pgran_inner_radius", "1e-300"])},
    # parts
    "no such case": (["-pgran_case", "nosuch"], "-pgran_case nosuch: allowed is"),
    "no such module": (["-pgran_law", "nosuch.package:Law"], "cannot be imported"),
    "no such file of a case": (["-pgran_case", "nosuch.py:A"], "there is no such file"),
    "no such class": (["-pgran_case", "shape.py:B"], "has no class B"),
    "broken file": (["-pgran_law", "law.py:Law"], "this law is not ready"),
    "file that leaves": (["-pgran_law", "leave.py:Law"], "leave.py cannot be imported: SystemExit"),
    "wrong kind": (["-pgran_law", "shape.py:A"], "is not a subclass"),
    "bad shape": (["-pgran_case", "shape.py:A"], "its shape is"),
    # output
    "XDMF as output": (["-pgran_output", "x.xdmf"], "a file name that ends in .h5"),
    "device as output": (["-pgran_output", "/dev/null"], "a file name that ends in .h5"),
    "pipe as output": (["-pgran_output", "pipe.h5"], "not a regular file"),
    "folder as output": (["-pgran_output", "folder.h5"], "not a regular file"),
    "file as folder": (["-pgran_output", "keep.h5/x.h5"], "-pgran_output keep.h5/x.h5: "),
    "checkpoint as output": (["-pgran_output", "keep.checkpoint_000049.h5"],
                             "this is the name of a checkpoint of keep.h5"),
    "no folder": (["-pgran_output", "/proc/none/x.h5"], "-pgran_output /proc/none/x.h5: "),
    # restart and seed
    **{f"restart from {kind}": (["-pgran_restart", f"{kind}.h5"],
                                f"-pgran_restart {kind}.h5: {text}")
       for kind, text in {
           "nosuch": "there is no such file", "text": "it cannot be read", "folder": "it is not a",
           "empty": "it cannot be read", "truncated": "it cannot be read", "pipe": "it is not a",
           "other": "it is no result", "data": "it is no result", "flat": "snapshot 0000 has no",
           "odd": "inertial_number of snapshot", "strange": "its options cannot be read",
           "untold": "it is no result", "mute": "its options cannot be read",
           "keep": "it has no checkpoint to go on from"}.items()},
    "restart with another width": (["-pgran_restart", "keep.h5", "-pgran_width", "16"],
                                   "cannot change -pgran_width (here 16, there 8.0)"),
    "restart in time from a snapshot": (["-pgran_restart", "keep.h5", "-pgran_restart_snapshot",
                                         "0"], "-pgran_restart_snapshot 0: allowed only with "
                                        "-ts_type pseudo"),
    "restart with another law": (["-pgran_restart", "keep.h5", "-pgran_law", "jop"],
                                 "cannot change -pgran_law (here jop, there bingham)"),
    **{f"steady from {kind}": (["-ts_type", "pseudo", "-pgran_restart", f"{kind}.h5"], text)
       for kind, text in {
           "text": "it cannot be read", "other": "it is no result", "nothing": "it holds 0 snaps",
           "lost": "has no coordinates", "keep": "its 5 x 5 nodes are not"}.items()},
    "steady from no snapshot": (["-ts_type", "pseudo", "-pgran_restart", "keep.h5",
                                 "-pgran_restart_snapshot", "7"], "it holds 1 snapshots"),
    "seed that is no mode": (["-pgran_mode_file", "keep.h5"], "it holds no mode"),
    "seed that is text": (["-pgran_mode_file", "text.h5"], "-pgran_mode_file text.h5: it cannot be read"),
    # PETSc
    "ts_type": (["-ts_type", "euler"], "-ts_type euler: allowed is beuler | pseudo"),
    "no steps": (["-ts_max_steps", "0"], "-ts_max_steps 0: must be an integer >= 1"),
    "start of TS": (["-ts_init_time", "0.001"], "-ts_init_time 0.001: must be 0, the time"),
    "step": (["-ts_dt", "1e-4"], "-ts_dt 1e-4: not allowed; use -pgran_step_first"),
    "step repeated as it is": (["-ts_adapt_scale_solve_failed", "1"],
                               "-ts_adapt_scale_solve_failed 1: must be a number > 0 and < 1"),
    "no iterations": (["-snes_max_it", "-1"], "-snes_max_it -1: must be an integer >= 1"),
    "no number": (["-snes_rtol", "nan"], "-snes_rtol nan: allowed is a number"),
    **{name: ([f"-{name}"], f"-{name} 1: must be false: a failed step is repeated")
       for name in ("snes_error_if_not_converged", "ksp_error_if_not_converged",
                    "ts_error_if_step_fails")},
    "dm_mat_type": (["-dm_mat_type", "nosuch"], "-dm_mat_type nosuch: must be aij or nest"),
    "blocks for MUMPS": ([*DIRECT, "-dm_mat_type", "nest"],
                         "-dm_mat_type nest: requires -pc_type fieldsplit, not lu"),
    "blocks split": (["-dm_mat_type", "nest", "-pc_type", "fieldsplit", "-ksp_type", "fgmres"],
                     "-dm_mat_type nest: requires -pc_fieldsplit_0_fields 0,1, not 0"),
    "pc_type": (["-pc_type", "nosuch"], "-pc_type nosuch: Unknown type"),
    "ksp_type": (["-ksp_type", "nosuch"], "-ksp_type nosuch: Unknown type"),
    "snes_type": (["-snes_type", "nosuch"], "-snes_type nosuch: Unknown type"),
    "line search": (["-snes_linesearch_type", "nosuch"], "-snes_linesearch_type nosuch"),
    "number": (["-snes_rtol", "small"], "-snes_rtol small"),
    "integer": (["-snes_max_it", "many"], "-snes_max_it many"),
    "package": ([*DIRECT, "-pgran_output", "keep.h5", "-pc_factor_mat_solver_type", "nosuch"],
                "-pc_factor_mat_solver_type nosuch"),
    "field": (["-pc_type", "fieldsplit", "-pc_fieldsplit_0_fields", "7", "-ksp_type", "fgmres"],
              "the fields of this model are"),
}
#: Arguments of other commands.
COMMANDS = [
    ("eigen", ["-eps_nev", "0"], "-eps_nev 0: "),
    ("eigen", ["-target", "nan"], "-target nan: allowed is"),
    ("eigen", ["-st_type", "nosuch"], "-st_type nosuch: Unknown type"),
    ("eigen", ["-eps_tol", "abc"], "-eps_tol abc"),
    ("eigen", ["-refinement", "1"], "-refinement 1: allowed is"),
    ("eigen", ["-refinment", "8"], "-refinment: no such option; did you mean -refinement?"),
    ("eigen", ["-wave_vector", "1,0"], "-wave_vector 1,0: allowed is"),
    ("eigen", ["-wave_vector", "1"], "-wave_vector 1: allowed is"),
    ("eigen", ["-wave_vector", "1e8,1e8"], "no eigenvalue converged"),
    ("eigen", ["-pgran_output", "pipe.h5", "-pgran_cell_elements", "2"], "not a regular file"),
    ("eigen", ["-pgran_cell_elements", "1000000"], "more than the indices"),
    ("eigen", ["-pgran_A", "1e300"], "-pgran_A 1e300: too large or too small to compute with"),
    *(("stability", given, f"{' '.join(given[-2:])}: too large or too small to compute with")
      for given in (["-cutoff", "-pgran_A", "1e300"], ["-wave_vector", "1e300,1"],
                    ["-specimen", "-pgran_A", "1e300"],
                    ["-cutoff", "-pgran_inertial_number", "1e-300"])),
    ("growth", ["-dt", "nan"], "-dt nan: allowed is"),
    ("growth", ["-dt", "inf"], "-dt inf: allowed is"),
    ("growth", ["-dt", "0"], "-dt 0: allowed is"),
    ("growth", ["-dt", "1e3", *COARSE], "step of 1000/gdot0 (-dt) has changed"),
    ("growth", ["-dt", "1e-3,1e-3"], "-dt 0.001,0.001: allowed are steps that differ"),

    ("growth", ["-without", "nosuch"], "-without nosuch: allowed is"),
    ("measure", [], ""),
    ("measure", ["nosuch.h5"], "there is no such file"),
    *(("measure", [f"{kind}.h5"], text) for kind, text in {
        "text": "cannot be read", "truncated": "cannot be read", "other": "no result",
        "data": "no result", "nothing": "it holds 0 snapshots", "flat": "has no coordinates",
        "odd": "no field of numbers", "words": "no field of numbers", "lost": "no coordinates",
        "pipe": "not a regular file", "folder": "not a regular file"}.items()),
    ("measure", ["-meshes", "keep.h5", "other.h5"], "no result"),
    ("measure", ["-nosuch", "keep.h5"], "-nosuch: no such option"),
    ("plot", ["other.h5"], "no result"),
    ("plot", ["nothing.h5"], "it holds 0 snapshots"),
    ("plot", ["words.h5"], "no field of numbers"),
    ("figures", ["fig0"], "fig0: allowed is"),
    ("figures", ["fig6", "-results", "nosuch"], "no results in nosuch"),
    ("stability", ["-wave_vector", "a,b"], "-wave_vector a,b: allowed is"),
    ("stability", ["-wave_vector"], "-wave_vector: a value is missing"),
    ("stability", ["-nosuch", "1"], "-nosuch: no such option"),
    ("stability", ["-cutoff", "-pgran_mu_s", "0"], "-pgran_mu_s 0: allowed is"),
    ("stability", ["bare"], "bare"),
]


def refused(done, message, folder, before):
    """Assert that a command ended with one message, at once, and left the files alone."""
    assert done.code == 1, (done, message)
    told = [line for line in done.errors.splitlines() if "error: " in line]
    assert len(told) == 1 or not message, done.errors
    assert "Traceback" not in done.errors and "PETSC ERROR" not in done.errors, done.errors
    assert message in done.errors, done.errors
    assert sorted(path.name for path in folder.iterdir()) == sorted(before)
    assert (folder / "keep.h5").read_bytes() == before["keep.h5"]


@pytest.fixture(scope="module")
def before(folder):
    """The names in the folder, and the earlier result byte by byte."""
    names = dict.fromkeys(path.name for path in folder.iterdir())
    return {**names, "keep.h5": (folder / "keep.h5").read_bytes()}


@pytest.mark.parametrize("given, row", [
    pytest.param(given, row, id="-".join([*given[1:], row.name])) for given, row in rows()])
def test_a_value_that_an_option_does_not_allow_is_an_error(given, row):
    texts = {name.lstrip("-"): value for name, value in zip(given[::2], given[1::2])}
    with pytest.raises(options.ParameterError) as error:
        cases.read({**texts, f"pgran_{row.name}": below(row)})
    assert error.value.as_option().startswith(f"-pgran_{row.name} {below(row)}: allowed is ")


#: One row of each kind of option.
KINDS = {row.kind: (given, row) for given, row in rows()}


@pytest.mark.parametrize("kind", KINDS)
def test_a_value_that_an_option_does_not_allow_is_refused(server, folder, before, kind):
    (given, row), value = KINDS[kind], below(KINDS[kind][1])
    done = server("__main__", ["-pgran_output", "keep.h5", *given, f"-pgran_{row.name}", value],
                  folder)
    refused(done, f"-pgran_{row.name} {value}: allowed is ", folder, before)


@pytest.mark.parametrize("name", RUNS)
def test_a_run_that_cannot_be_is_refused(server, folder, before, name):
    arguments, message = RUNS[name]
    done = server("__main__", ["-pgran_output", "keep.h5", *(
        () if {"-pgran_element_size", "-pgran_case"} & set(arguments) else COARSE), *arguments],
                  folder)
    refused(done, message, folder, before)


@pytest.mark.parametrize("name, value, message", [
    ("PETSC_OPTIONS", "-pgran_width 40 80", "80: not an option, nor the value of one"),
    ("PETSC_OPTIONS", "-options_file nosuch", "-options_file nosuch: there is no such file"),
    ("PETSC_OPTIONS", "-pgran_width '40", "PETSC_OPTIONS: no closing quotation"),
    ("PETSC_OPTIONS", "-options_file_yaml two.opts", "options are not read from YAML"),
    ("PETSC_OPTIONS", "-pgran_widht 40", "did you mean -pgran_width"),
    ("PETSC_OPTIONS_YAML", "a: b", "PETSC_OPTIONS_YAML: options are not read from YAML"),
    ("HOME", "home", ".petscrc, line 2: neither is no option")])
@pytest.mark.parametrize("command", ["__main__", "growth"])
def test_all_that_petsc_reads_options_from_is_checked(server, folder, before, command, name, value,
                                                      message):
    done = server(command, ["-pgran_output", "keep.h5", *COARSE], folder, **{name: value})
    refused(done, message, folder, before)


@pytest.mark.parametrize("command, arguments, message", COMMANDS,
                         ids=[f"{name} {' '.join(given)}" for name, given, _ in COMMANDS])
def test_other_commands_refuse_what_they_cannot_read(server, folder, before, command, arguments,
                                                     message):
    case = ("-pgran_case", "periodic") if command == "eigen" else ()
    done = server(command, [*case, *arguments], folder)
    refused(done, message, folder, before)


@pytest.mark.parametrize("command", ["__main__", "eigen", "growth", "measure", "plot", "figures",
                                     "stability", "watch"])
def test_every_command_has_the_same_three_ways_to_ask_for_help(server, folder, command):
    texts = set()
    for flag in ("-help", "--help", "-h"):
        done = server(command, [flag], folder)
        assert done.code == 0 and not done.errors, (flag, done)
        texts.add(done.output)
    assert len(texts) == 1 and len(texts.pop()) > 100
