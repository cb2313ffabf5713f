"""The summary of a sweep as files."""

from __future__ import annotations

from ..models.files import yaml_text
from ..models.output import output_folder
from ..scenarios.studies.statistics import write_csv
from ..scenarios.studies.swept import Swept
from ..views.sweep_tables import sweep_markdown


def write_summary(swept: Swept, figures: bool = True) -> None:
    """Write `summary.csv`, `summary.md`, the worst runs as scenarios, and figures into the dataset's folder."""
    found, study = list(swept.aggregates), swept.study
    with output_folder(swept.folder, "sweep") as new:
        write_csv(found, swept.dataset.design, new / "summary.csv")
        (new / "summary.md").write_text(sweep_markdown(found, study), encoding="utf-8")
        for run in swept.worst:
            if run.again is not None:
                (new / "worst").mkdir(exist_ok=True)
                text = yaml_text(run.again.model_dump(mode="json", exclude_none=True))
                (new / "worst" / f"{run.scenario}.yaml").write_text(text, encoding="utf-8")
        if figures:
            from ..views.sweep_figures import save_sweep_figures

            save_sweep_figures(found, study, new / "figures")
