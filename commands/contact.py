"""`flexspline contact`: collision detection on each estimator's external torque."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Annotated

import typer

from ._listing import AsJson
from ._options import Changes, shipped, with_plugins

EXAMPLES = (
    "flexspline contact --hours 0.2 --filter RAREKF --filter augmented",
    "flexspline contact --set sensors=realistic --tolerance 0.2 --out contact",
)
DEFAULT = ("augmented", "momentum", "momentum_torsion", "current", "RAREKF", "AREKF", "EKF", "model")
"""Estimators where none is named: those that take no more than a few microseconds per update, a few of each kind."""


@with_plugins
def command(
    scenario: Annotated[
        str, typer.Argument(help="Whose motion is drawn: name or path.", autocompletion=shipped("scenarios"))
    ] = "collision",
    hours: Annotated[
        float, typer.Option(min=0.05, max=100.0, help="Without contact; half of them give the thresholds.")
    ] = 1.0,
    tolerance: Annotated[
        list[float] | None,
        typer.Option(
            min=0, max=100, help="Share of the joint's tolerances; repeatable. 0 (known exactly) and 1 by default."
        ),
    ] = None,
    filter_: Annotated[
        list[str] | None,
        typer.Option("--filter", help=f"An estimator by its name; repeatable. By default {', '.join(DEFAULT)}."),
    ] = None,
    rate: Annotated[
        float, typer.Option(min=0.01, max=1e6, help="False alarms per hour at which they are compared.")
    ] = 10.0,
    threads: Annotated[int, typer.Option(min=1, help="Runs at a time; the result does not depend on it.")] = 1,
    out: Annotated[Path | None, typer.Option(help="Folder for contact.csv (curves), contact.md, contact.png.")] = None,
    changes: Changes = None,
    as_json: AsJson = False,
) -> None:
    """Detect collisions by each estimator's external torque: false alarms per hour, delay, smallest push found.

    Thresholds come from runs without contact, false alarms from others of them, delay and the smallest push from runs with drawn
    pushes. Every run is another joint within tolerance, another motion and another noise.
    """
    from ..models.errors import InputError, InputWarning
    from ..models.output import check_output, output_folder
    from ..scenarios.evaluation import contact
    from ..scenarios.filters import estimators
    from ..scenarios.scenario import load_scenario
    from ..views import contact_views
    from ._console import console, progress

    shares = tolerance or [0.0, 1.0]
    if len(set(shares)) < len(shares):
        raise InputError(f"--tolerance: expected each share once, got {shares}")
    chosen = estimators(filter_ or DEFAULT)
    loaded, folder = load_scenario(scenario, changes)
    contact.check(loaded, chosen)
    if out is not None:
        check_output(out, "contact", writes=("contact.csv", "contact.md", "contact.png"))
    seconds = contact.runs_of(loaded, hours) / 2 * (loaded.duration - loaded.transient)
    if rate * seconds < 3600.0:
        asked = f"for thresholds of {rate:g} false alarms an hour"
        text = f"--hours: expected at least {2 / rate:.2g} {asked}, got {hours:g}: curves alone"
        warnings.warn(text, InputWarning, stacklevel=2)
    terminal, rows, texts, points = console(), [], [], {}
    with progress() as bar:
        for share in shares:
            task = bar.add_task(f"tolerance ×{share:g}", total=contact.runs_of(loaded, hours))
            found = contact.assess(
                loaded,
                folder,
                chosen,
                hours,
                share,
                threads,
                lambda task=task: bar.advance(task),  # type: ignore[misc]
            )
            at_rate = {one.name: contact.at(one, one.threshold(rate)) for one in found}
            points[share] = at_rate
            rows += [row for one in found for row in contact.curve(one, share)]
            title = (
                f"{loaded.name}, joint within tolerance ×{share:g}: thresholds for {rate:g} false alarms per hour, "
                f"{found[0].hours:.2g} h counted"
            )
            texts.append((title, at_rate))
    if not as_json:
        for title, at_rate in texts:
            terminal.print(contact_views.contact_table(at_rate, title))
        if any(math.isnan(point.threshold) for _, at_rate in texts for point in at_rate.values()):
            terminal.print(
                f"–: too few seconds for a threshold of {rate:g} false alarms per hour: half of --hours gives it, which takes "
                f"at least {2 / rate:.2g} h, and runs that do not diverge"
            )
    if out is not None:
        with output_folder(out, "contact") as new:
            contact_views.write_curves(rows, new / "contact.csv")
            text = "".join(f"## {title}\n\n{contact_views.contact_markdown(p)}\n\n" for title, p in texts)
            (new / "contact.md").write_text(text, encoding="utf-8")
            from ..views.limit_figures import save_figure

            save_figure(contact_views.contact_figure(rows, loaded.name), new / "contact.png")
        if not as_json:
            terminal.print(f"{out / 'contact.csv'}, contact.md, contact.png")
    if as_json:
        from ..models.files import json_text

        print(json_text(contact_views.as_data(points)))
