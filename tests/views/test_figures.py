"""The figures that fit a scenario, drawn and not empty."""

from __future__ import annotations

import itertools
import subprocess
import sys

import matplotlib
import numpy as np
import pytest
from matplotlib.image import imread

from flexspline.models.errors import InputError
from flexspline.scenarios.run import run_scenario
from flexspline.scenarios.scenario import load_scenario
from flexspline.views import figures
from flexspline.views.figures import paper, sheet, signals
from flexspline.views.figures.run import overview

GENERAL = {"overview", "filters", "error"}


def caption(figure) -> str:
    return " ".join(text.get_text().replace("\n", " ") for text in figure.texts)


def test_pushes_give_the_papers_figures_8_and_9(pushed, tmp_path):
    made = {name: make(pushed) for name, make in figures.chosen(pushed).items()}
    assert set(made) == {"fig8_external_push", "fig9_zoom"} | GENERAL
    assert "Paper:" in caption(made["fig8_external_push"])
    assert "Ours" in caption(made["fig9_zoom"])
    assert [push.torque for push in paper.zoomed(pushed)] == [5, -5]


def test_figures_are_written_as_pictures_with_something_on_them(bare, tmp_path):
    paths = figures.save_figures(bare, tmp_path / "figures")
    assert {path.stem for path in paths} == {"fig5_no_load"} | GENERAL and len(paths) == len(set(paths))
    for path in paths:
        image = imread(path)
        assert image.shape[1] > 1000
        assert np.mean(image[..., :3] < 0.9) > 0.01, f"{path.name} is almost empty"


def test_no_load_shows_the_limit_that_the_paper_states(bare):
    figure = paper.no_load(bare)
    labels = figure.axes[1].get_legend_handles_labels()[1]
    assert "paper: ±0.1 N·m" in labels
    assert "below 0.1 N·m" in caption(figure)


def test_hysteresis_loop_gives_figure_3_with_its_width():
    loop = "disturbances=[{kind: sine, start: 0.1, duration: 6, torque: 15, cycles: 1.5}]"
    run = run_scenario(*load_scenario("hysteresis_loop", ["duration=6.2", loop, "transient=0.1"]))
    figure = figures.chosen(run)["fig3_stiffness"](run)
    labels = figure.axes[0].get_legend_handles_labels()[1]
    width = next(float(label.split()[2]) for label in labels if label.startswith("Ψ"))
    assert width / 2 == pytest.approx(0.157, rel=0.1)  # mrad, of the reference loop


def test_width_of_a_known_loop():
    phase = np.linspace(0, 4 * np.pi, 4001)
    torque = 10 * np.sin(phase)
    torsion = torque / 8 - 0.2 * np.sign(np.cos(phase))
    assert paper.half_width(torque, torsion) == pytest.approx(0.2, rel=1e-2)
    assert paper.half_width(np.abs(torque) + 1, torsion) == 0.0


def test_the_style_stays_inside(bare):
    before = dict(matplotlib.rcParams)
    overview(bare)
    assert dict(matplotlib.rcParams) == before


def test_panels_do_not_cover_each_other(pushed):
    """Labels and legends of the panels stay apart and on the sheet, in the picture's pixels."""
    figure = paper.external_push(pushed)
    figure.canvas.draw()
    boxes = [axes.get_tightbbox() for axes in figure.axes[:3]]
    for upper, lower in itertools.pairwise(boxes):
        assert upper.y0 > lower.y1 - 1
    assert min(box.x0 for box in boxes) > 0 and max(axes.get_tightbbox().x1 for axes in figure.axes) < figure.bbox.width


def test_a_noisy_line_is_a_band_that_keeps_its_spikes(rng):
    _, ((axes,),) = sheet.sheet("t", "c", [2.0])
    time, values = 1e-3 * np.arange(80_000), rng.normal(size=80_000)
    values[31_234] = 30.0
    signals.line(axes, time, values, "#112233", "noise")
    (band,) = axes.collections
    corners = band.get_paths()[0].vertices
    assert corners[:, 1].max() == 30.0 and corners[:, 1].min() == values.min()
    assert len(corners) < 2.2 * sheet.PIXELS + 10
    assert axes.get_legend_handles_labels()[1] == ["noise"]
    signals.line(axes, time, np.sin(time), "#112233", "smooth")
    assert len(axes.collections) == 1
    assert len(axes.lines[-1].get_xdata()) <= 2 * sheet.PIXELS + 4


def test_nothing_loads_matplotlib_before_a_figure_is_drawn():
    program = "import sys, flexspline.views.figures, flexspline.views.tables; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0


def test_response_is_relative_to_the_truth(pushed):
    text = caption(paper.push_zoom(pushed))
    late = pushed.metrics["filters"]["EKF"]["response_ms"]
    assert f"EKF {late:.1f} ms" in text and "after the truth" in text


def test_a_folder_that_cannot_be_written_is_refused_in_one_line(bare, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError) as error:
        figures.save_figures(bare, tmp_path / "file" / "figures")
    assert "\n" not in str(error.value)


def test_legends_stand_in_a_row_that_ends_with_the_panel(pushed):
    figure = paper.external_push(pushed)
    figure.canvas.draw()
    top, legend = figure.axes[0].bbox, figure.axes[0].get_legend()
    assert [t.get_text() for t in legend.get_texts()] == ["torque sensor", "truth", "RAREKF"]
    boxes = [t.get_window_extent() for t in legend.get_texts()]
    assert max(box.x1 for box in boxes) == pytest.approx(top.x1, abs=10)
    assert all(box.y0 > top.y1 for box in boxes)
    assert all(left.x1 < right.x0 for left, right in itertools.pairwise(boxes))
