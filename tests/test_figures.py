"""The figures of the theory are drawn, with their numbers and the paper's beside them."""

import h5py
import numpy as np
import pytest

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


@pytest.mark.parametrize("arguments", [[], ["fig99"]])
def test_unknown_figures_are_refused(arguments, capsys):
    assert figures.main(arguments) == 1
    assert "allowed is fig1 fig2" in capsys.readouterr().err
