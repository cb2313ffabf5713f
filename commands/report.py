"""`flexspline report`: one self-contained page of a result, to send to a colleague."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from ..models.errors import InputError
from ._console import console
from ._options import AsJson, argument, option, with_plugins

HOLDS = "a run, an arm's run, a comparison, a diagnosis, a validation, a sweep or contact"  # what a folder may hold
_MARK = '<meta name="generator" content="flexspline">'

EXAMPLES = (
    "flexspline report runs/external_push",
    "flexspline report runs --out comparison.html",
    "flexspline report before after --out repair.html",
    "flexspline report validation --out validation.html",
    "flexspline report sweep --out study.html",
    "flexspline report contact --out contact.html",
)


@with_plugins
def command(
    folders: Annotated[
        list[Path], argument(f"of {HOLDS}; or two diagnoses of a joint, before and after", metavar="FOLDER [FOLDER]")
    ],
    out: Annotated[Path, option("the page, an HTML file without references to others")] = Path("report.html"),
    as_json: AsJson = False,
) -> Any:
    """Write one self-contained page of a run, a comparison, a diagnosis, a validation, a sweep or contact; or of two diagnoses.

    It begins with the result, its confidence and what to do, and ends with its sources. Charts zoom, show values and hide lines.
    It is readable in light and dark mode, on a phone and on paper.
    """

    write_page(folders, out)
    if as_json:
        return {"page": str(out), "of": [str(folder) for folder in folders]}
    console().print(f"{out}")


def write_page(folders: Sequence[Path], out: Path) -> None:
    """Write one self-contained HTML page (`flexspline.report`) of a folder with results (`HOLDS`), or of two diagnoses
    of a joint, before and after; only a page of this program is replaced. Raises `InputError`: a folder with other
    content; another file in place of the page."""
    from ..models.files import write_text

    if out.is_dir():
        raise InputError(f"{out}: expected a file, got a folder")
    if not out.parent.is_dir():
        raise InputError(f"{out}: expected a file in an existing folder, got {out.parent}")
    if out.exists() and _MARK not in out.read_text(encoding="utf-8", errors="replace")[:2000]:
        raise InputError(f"{out}: expected no file, or a page of this program, got another file")
    write_text(out, _page(folders))


def _page(folders: Sequence[Path]) -> str:
    for folder in folders:
        if not folder.is_dir():
            raise InputError(f"{folder}: expected a folder of {HOLDS}, found none")
    if len(folders) == 2:
        from ..views.pages.two_diagnoses import read_diagnosis, two_html

        return two_html(*(read_diagnosis(folder) for folder in folders))
    if len(folders) != 1:
        raise InputError(f"report: expected one folder, or two diagnoses, got {len(folders)}")
    (folder,) = folders
    if (folder / "diagnosis.json").is_file():
        page = folder / "report.html"
        if not page.is_file():
            why = "expected the page of the diagnosis, found none; diagnose again without --no-report"
            raise InputError(f"{page}: {why}")
        return page.read_text(encoding="utf-8")
    if (folder / "validation.json").is_file():
        from ..views.pages.validation import read_validation, validation_html

        return validation_html(read_validation(folder))
    if (folder / "study.json").is_file():
        return _sweep(folder)
    if (folder / "contact.csv").is_file():
        from ..views.pages.contact import contact_html, read_answer, read_curves

        return contact_html(read_answer(folder / "contact.json"), read_curves(folder / "contact.csv"), folder)
    if (folder / "scenario.yaml").is_file():
        return _runs([folder])
    found = sorted(path.parent for path in folder.glob("*/scenario.yaml"))
    if found and (folder / "arm.yaml").is_file():
        return _runs(_from_the_base(found, folder / "arm.yaml"), arm=folder)
    if found:
        return _runs(found)
    raise InputError(f"{folder}: expected a folder of {HOLDS}, got something else")


def _from_the_base(folders: list[Path], arm: Path) -> list[Path]:
    from ..scenarios.arms.arm_scenario import load_any

    scenario, _ = load_any(arm)
    order = [joint.name for joint in getattr(scenario, "arm", ())]
    return sorted(folders, key=lambda folder: order.index(folder.name) if folder.name in order else len(order))


def _runs(folders: list[Path], arm: Path | None = None) -> str:
    from ..diagnosis.bode import excited_response
    from ..models.recording import Measurement
    from ..scenarios.run_folder import load_run
    from ..views.pages.run import runs_html

    runs = [load_run(folder) for folder in folders]
    data = [Measurement(run.name, folder, (run.as_recording(),)) for run, folder in zip(runs, folders, strict=True)]
    responses = [excited_response(one, run.known_joint) for one, run in zip(data, runs, strict=True)]
    return runs_html([*zip(runs, folders, strict=True)], arm, responses)


def _sweep(folder: Path) -> str:
    from ..models.files import parse
    from ..scenarios.studies.dataset import read_note, read_values
    from ..scenarios.studies.statistics import read_csv
    from ..scenarios.studies.study import Study
    from ..views.pages.sweep import sweep_html

    note = read_note(folder / "study.json")
    study = parse(note["study"], Study, str(folder / "study.json"))
    found = read_csv(folder / "summary.csv", study)
    worst = sorted((folder / "worst").glob("*.yaml"))
    values = read_values(folder, study)
    return sweep_html(study, found, note["versions"], note["digest"], folder, _study_of(note, folder), worst, values)


def _study_of(note: dict[str, Any], folder: Path) -> str:
    """Return the study of a sweep for a command line from here: a shipped study's name, or a path; empty if unknown."""
    from ..scenarios.studies.study import shipped_studies

    source = note.get("source") or note["study"]["name"]
    if source in shipped_studies():
        return source
    if "source" not in note:
        return ""
    path = (folder.resolve() / source).resolve()
    return path.as_posix() if folder.is_absolute() else Path(os.path.relpath(path)).as_posix()
