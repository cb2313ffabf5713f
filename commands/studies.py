"""`flexspline studies`: studies by name."""

from __future__ import annotations

from ._console import Entry, show
from ._options import AsJson

EXAMPLES = ("flexspline studies", "flexspline studies --json")


def command(as_json: AsJson = False) -> None:
    """List the studies of this package; `flexspline sweep` takes one of these names, or the path of a YAML file."""
    from ..scenarios.studies.design import Design
    from ..scenarios.studies.study import load_study, shipped_studies

    entries = {}
    for name, path in shipped_studies().items():
        study, folder = load_study(name)
        kind = f"{study.seeds.count} seeds, {Design.of(study, folder).runs} runs"
        entries[name] = Entry(kind, study.description, str(path))
    show("study", entries, as_json)
