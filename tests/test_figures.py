"""The paper's figures are drawn, with computed numbers and the numbers of the paper."""

import h5py
import numpy as np
import pytest

from pgran import figures


def test_figures_of_the_theory_are_drawn_with_their_numbers(tmp_path, capsys):
    assert figures.main(["fig1", "fig2", "fig8", "fig9", "-output", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    for row in (
            "| quasi-static cut-off, mu_s = 0.3819 | 0.123 | 0.12265 |",
            "| IG, I0 = 0.1: unstable near the origin | no | no |",
            "| wave vectors whose stability changes / unstable ones, I0 = 1 | quite different | "
            "15.236 |", "| b I0 where the Bingham cut-off vanishes | 0.0158 | 0.015723 |"):
        assert row in text
    for name in ("fig1", "fig2", "fig8", "fig9"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10000
    with h5py.File(tmp_path / "fig2.h5") as file:
        assert file["k_cut"].shape == (200, 200)


@pytest.mark.parametrize("name, model, compression", [("fig6", "ngf", 0.1), ("fig7", "li", 0.01)])
def test_a_figure_of_simulations_shows_the_runs_that_exist(tmp_path, capsys, name, model,
                                                           compression):
    results, pictures = tmp_path / "results", tmp_path / "pictures"
    results.mkdir()
    arguments = [name, "-results", str(results), "-output", str(pictures)]
    assert figures.main(arguments) == 1
    assert f"run bash jobs/study.sh section4 {name}" in capsys.readouterr().err
    x, y = np.meshgrid(np.linspace(0.0, 42.0, 21), np.linspace(0.0, 108.0, 61))
    for size in (2, 1):
        with h5py.File(results / f"{model}_L40_I0.001_h{size}.h5", "w") as file:
            file.attrs["options"] = (f"-pgran_model {model}\n-pgran_element_size {size:g}\n"
                                     "-pgran_inertial_number 0.001\n")
            group = file.create_group("snapshots/0000")
            group.attrs["compression"] = compression
            group["coordinates"] = np.stack([x, y], axis=-1)
            group["inertial_number"] = 4e-3 * np.exp(-((y - 54.0 - 1.23 * (x - 21.0)) / 15.0)**2)
    assert figures.main(arguments) == 0
    text = capsys.readouterr().out
    assert (pictures / f"{name}.png").stat().st_size > 10000
    assert f"not drawn, because the run is missing: {model}_L40_I0.001_h0.5" in text
    assert ("angle (degrees)" in text) != ("bands across the line at L/4" in text)
    with h5py.File(pictures / f"{name}.h5") as file:
        assert file["a/I"].shape == file["b/I"].shape == (61, 21)
