"""The figures of the theory are drawn, with their numbers and the paper's beside them."""

import h5py
import numpy as np
import pytest
from conftest import run_ranks

from pgran import figures


def test_figures_of_the_theory_come_with_their_numbers(tmp_path, capsys):
    assert figures.main(["fig1", "fig2", "fig8", "fig9", "-output", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    for name in ("fig1", "fig2", "fig8", "fig9"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10000
        with h5py.File(tmp_path / f"{name}.h5") as file:
            assert len(file) > 2
    for statement in ("quasi-static cut-off, mu_s = 0.3819", "b I0 where the Bingham cut-off",
                      "fastest direction at I0 = 0.001", "IG, I0 = 0.1: unstable near the origin"):
        assert statement in text
    with h5py.File(tmp_path / "fig2.h5") as file:
        assert file["k_cut"].shape == (200, 200)
        assert file["k_cut_quasi_static"][...].max() < 1.0
    with h5py.File(tmp_path / "fig9.h5") as file:
        same = (file["without_a"][...] > 0.0) == (file["with_a"][...] > 0.0)
        assert np.mean(same) > 0.999
    # At I0 = 1 convection changes sides: by the eigenvalues of (A 7), and on v.k = 0.
    rows = {line.rsplit("computed ", 1)[0].strip(): line.rsplit("computed ", 1)[1]
            for line in text.splitlines() if "change sides at I0 = 1," in line}
    full, reduced = (next(float(value) for key, value in rows.items() if mark(key))
                     for mark in (lambda key: "v.k" not in key, lambda key: "v.k" in key))
    assert full == pytest.approx(15.24, abs=0.01) and reduced == pytest.approx(11.67, abs=0.01)


def test_unknown_figures_are_refused(capsys):
    assert figures.main(["fig99"]) == 1
    assert "fig99: allowed is fig1 fig2" in capsys.readouterr().err


def test_figures_take_the_parameters_of_the_paper_whatever_the_defaults_are(tmp_path):
    """Other defaults in the tables of options change no figure."""
    code = """
import dataclasses, sys
from pgran import options
from pgran.material import laws
laws.MU_S = dataclasses.replace(laws.MU_S, default=0.5)
from pgran import cases
assert cases.read({}).mu_s == 0.5
from pgran.figures import main
sys.exit(main(["fig2", "-output", sys.argv[1]]))
"""
    text = run_ranks(0, "-c", code, tmp_path).stdout
    assert "0.12265" in text


def test_a_figure_of_section_4_is_drawn_from_what_is_there(tmp_path, capsys):
    results, pictures = tmp_path / "results", tmp_path / "pictures"
    results.mkdir()
    given = ["fig6", "-results", str(results), "-output", str(pictures)]
    assert figures.main(given) == 1
    assert "bash jobs/fig6.sh makes them" in capsys.readouterr().err
    for size, ratio in ((2, 1), (1, 2)):
        x, y = np.meshgrid(np.linspace(0.0, 42.0, 20 * ratio + 1),
                           np.linspace(0.0, 108.0, 60 * ratio + 1))
        with h5py.File(results / f"ngf_L40_I0.001_h{size}.h5", "w") as file:
            file.attrs["options"] = (
                f"-pgran_element_size {size:g}\n-pgran_inertial_number 0.001\n")
            group = file.create_group("snapshots/0000")
            group.attrs["compression"] = 0.10
            group["coordinates"] = np.stack([x, y], axis=-1)
            group["inertial_number"] = 4e-3 * np.exp(-((y - 54.0 - 1.23 * (x - 21.0)) / 15.0)**2)
    assert figures.main(given) == 0
    text = capsys.readouterr().out
    assert (pictures / "fig6.png").stat().st_size > 10000
    assert "not drawn, as the run is missing: ngf_L40_I0.001_h0.5" in text
    assert "h2 to h1: difference of I over its L2 norm" in text
    with h5py.File(pictures / "fig6.h5") as file:
        assert file["a/I"].shape == (61, 21) and file["b/I"].shape == (121, 41)
