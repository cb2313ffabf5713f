"""The figures that fit a scenario, drawn and not empty."""

from __future__ import annotations

import itertools

import matplotlib
import numpy as np
import pytest
from flexspline.models.errors import InputError
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import load_scenario
from flexspline.views import figures
from matplotlib.image import imread

GENERAL = {"overview", "filters", "error"}


def caption(figure) -> str:
    return " ".join(text.get_text().replace("\n", " ") for text in figure.texts)


def test_pushes_give_the_papers_figures_8_and_9(pushed, tmp_path):
    made = figures.figures_of(pushed)
    assert set(made) == {"fig8_external_push", "fig9_zoom"} | GENERAL
    assert "Paper:" in caption(made["fig8_external_push"])
    assert "Ours" in caption(made["fig9_zoom"])
    assert [push.torque for push in figures.zoomed(pushed)] == [5, -5]


def test_figures_are_written_as_pictures_with_something_on_them(bare, tmp_path):
    paths = figures.save_figures(bare, tmp_path / "figures")
    assert {path.stem for path in paths} == {"fig5_no_load"} | GENERAL
    for path in paths:
        image = imread(path)
        assert image.shape[1] > 1000
        assert np.mean(image[..., :3] < 0.9) > 0.01, f"{path.name} is almost empty"


def test_no_load_shows_the_limit_that_the_paper_states(bare):
    figure = figures.no_load(bare)
    labels = figure.axes[1].get_legend_handles_labels()[1]
    assert "paper: ±0.1 N·m" in labels
    assert "below 0.1 N·m" in caption(figure)


def test_hysteresis_loop_gives_figure_3_with_its_width():
    loop = "disturbances=[{kind: sine, start: 0.1, duration: 6, torque: 15, cycles: 1.5}]"
    run = run_scenario(*load_scenario("hysteresis_loop", ["duration=6.2", loop, "transient=0.1"]))
    figure = figures.figures_of(run)["fig3_stiffness"]
    labels = figure.axes[0].get_legend_handles_labels()[1]
    width = next(float(label.split()[2]) for label in labels if label.startswith("Ψ"))
    assert width / 2 == pytest.approx(0.157, rel=0.1)  # mrad, of the reference loop


def test_width_of_a_known_loop():
    phase = np.linspace(0, 4 * np.pi, 4001)
    torque = 10 * np.sin(phase)
    torsion = torque / 8 - 0.2 * np.sign(np.cos(phase))
    assert figures._half_width(torque, torsion) == pytest.approx(0.2, rel=1e-2)
    assert figures._half_width(np.abs(torque) + 1, torsion) == 0.0


def test_the_style_stays_inside(bare):
    before = dict(matplotlib.rcParams)
    figures.overview(bare)
    assert dict(matplotlib.rcParams) == before


def test_axes_do_not_cover_each_other(pushed):
    """Labels and legends of the panels stay apart, in the picture's pixels."""
    figure = figures.external_push(pushed)
    figure.draw_without_rendering()
    boxes = [axes.get_tightbbox() for axes in figure.axes[:3]]
    for upper, lower in itertools.pairwise(boxes):
        assert upper.y0 > lower.y1 - 1


def test_a_folder_that_cannot_be_written_is_refused_in_one_line(bare, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError) as error:
        figures.save_figures(bare, tmp_path / "file" / "figures")
    assert "\n" not in str(error.value)
