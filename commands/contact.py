"""`flexspline contact`: collision detection on each estimator's external torque."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..models.output import check_output, output_folder
from ._console import console, progress
from ._options import AsJson, Changes, Jobs, argument, option, shipped, with_plugins

if TYPE_CHECKING:
    from ..scenarios.evaluation.contact import ContactStudy

EXAMPLES = (
    "flexspline contact --hours 0.2 --filter RAREKF --filter augmented",
    "flexspline contact --set sensors=realistic --tolerance 0.2 --out contact",
)


@with_plugins
def command(
    scenario: Annotated[
        str, argument("Scenario with the motion: name or path.", autocompletion=shipped("scenarios"))
    ] = "collision",
    hours: Annotated[
        float, option("Time without contact; half of it gives the thresholds.", min=0.05, max=100.0)
    ] = 1.0,
    tolerance: Annotated[
        list[float] | None,
        option("Share of the joint's tolerances; repeatable. 0 (known exactly) and 1 by default.", min=0, max=100),
    ] = None,
    filter_: Annotated[
        list[str] | None,
        option(
            "An estimator by its name; repeatable. By default augmented, momentum, momentum_torsion, current, RAREKF, "
            "AREKF, EKF, model.",
            "--filter",
        ),
    ] = None,
    rate: Annotated[float, option("False alarms per hour at which detectors are compared.", min=0.01, max=3000)] = 10.0,
    jobs: Jobs = None,
    out: Annotated[
        Path | None, option("Folder for contact.json, contact.md, contact.csv (curves), contact.png.")
    ] = None,
    changes: Changes = None,
    as_json: AsJson = False,
) -> Any:
    """Detect collisions by each estimator's external torque: false alarms per hour, delay, smallest push found.

    Thresholds come from one half of the runs without contact, false alarms from the other half, delay and smallest push from runs
    with drawn pushes. Every run has another joint within tolerance, another motion and other noise.
    """
    from ..models import plugins
    from ..scenarios.evaluation import contact
    from ..scenarios.filters import estimators
    from ..scenarios.scenario import load_scenario
    from ..views import contact_views

    shares = tolerance or [0.0, 1.0]
    chosen = estimators(filter_ or contact.DEFAULT)
    loaded, folder = load_scenario(scenario, changes)
    contact.check(loaded, chosen, hours, rate, shares)
    if out is not None:
        check_output(out, "contact", writes=("contact.csv", "contact.json", "contact.md", "contact.png"))
    terminal = console()
    with progress() as bar:
        runs = contact.runs_of(loaded, hours)
        tasks = {share: bar.add_task(f"tolerance ×{share:g}", total=runs) for share in shares}
        found = contact.study(
            loaded, folder, chosen, hours, shares, rate, jobs or os.cpu_count() or 1, lambda share: bar.advance(tasks[share])
        )  # fmt: skip
    given = {
        "--tolerance": [f"{share:g}" for share in shares],
        "--filter": chosen,
        "--rate": [f"{rate:g}"],
        "--set": changes or [],
        "--plugin": plugins.files(),
    }
    words = [scenario, *(word for o, values in given.items() for v in values for word in (o, str(v)))]
    answer = {"format": 1, "arguments": words} | found.to_json()
    if out is not None:
        _write(out, answer, found)
    if as_json:
        return answer
    for title, own in contact_views.titles(answer):
        terminal.print(contact_views.contact_table(own, title))
        for reason in contact_views.reasons(own):
            terminal.print(reason, style="yellow")
    if out is not None:
        terminal.print(f"{out / 'contact.json'}, contact.md, contact.csv, contact.png")


def _write(out: Path, answer: dict[str, Any], found: ContactStudy) -> None:
    from ..models.files import write_json, write_rows
    from ..views import contact_views
    from ..views.figures.sheet import save

    with output_folder(out, "contact") as new:
        write_json(new / "contact.json", answer)
        write_rows(new / "contact.csv", list(found.curves))
        (new / "contact.md").write_text(contact_views.contact_markdown(answer), encoding="utf-8")
        save(contact_views.contact_figure(found.curves, found.scenario), new / "contact.png", 110)
