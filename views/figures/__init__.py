"""Figures of a run: those of the paper, and general ones.

The paper prints Figs. 3, 5, 7, 8 and 9 without their data, so that captions state the paper's text and the results of this run.
Errors are relative to the plant's noise-free joint torque unless a label says otherwise. matplotlib is loaded with the first
figure, and its settings are not changed.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..posteriors import innovations

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...scenarios.run import Run


def save_figures(run: Run, folder: Path) -> list[Path]:
    """Write a run's figures as PNG into a folder, which is made if it does not exist; return their paths. Raises
    `InputError`: the folder cannot be written."""
    from .sheet import save

    return [save(make(run), Path(folder) / f"{name}.png") for name, make in chosen(run).items()]


def chosen(run: Run) -> dict[str, Callable[[Run], Figure]]:
    """Return the functions that draw a run, by file name: figures of the paper that its scenario names, and general ones."""
    from . import paper
    from .run import error, filters, overview

    of_paper: dict[str, tuple[str, Callable[[Run], Figure]]] = {
        "3": ("fig3_stiffness", paper.stiffness),
        "5": ("fig5_no_load", paper.no_load),
        "7": ("fig7_link_sweep", paper.link_sweep),
        "8": ("fig8_external_push", paper.external_push),
        "9": ("fig9_zoom", paper.push_zoom),
    }
    found = dict(of_paper[number] for number in re.findall(r"\d+", run.scenario.figure) if number in of_paper)
    if "fig9_zoom" in found and not paper.zoomed(run):
        del found["fig9_zoom"]
    more = {"filters": filters} if innovations(run) else {}
    return found | {"overview": overview, **more, "error": error}
