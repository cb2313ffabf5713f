"""`flexspline joint show`: properties of a joint."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ...models.errors import InputError
from .._console import console
from .._options import AsJson, argument, option, with_plugins

if TYPE_CHECKING:
    from ...models.joint import Joint

EXAMPLES = (
    "flexspline joint show csg-25-100-tbm2g",
    "flexspline joint show my_joint.yaml --out my_joint.png",
    "flexspline joint show my_joint.yaml --gear-sheet gear.yaml",
)


@with_plugins
def command(
    joint: Annotated[str, argument("Name of a shipped joint, or a joint description.", metavar="JOINT")] = "test-joint",
    out: Annotated[Path | None, option("Write the figure to this file, .png.")] = None,
    gear_sheet: Annotated[Path | None, option("The gear's data sheet, .yaml, to compare the predictions with.")] = None,
    as_json: AsJson = False,
) -> Any:
    """Show a joint: stiffness, hysteresis, friction, resonances, resolution of the encoders, detectable causes.

    `--out joint.png` draws it. `--gear-sheet` adds the predicted friction and efficiency at each entry of a data sheet.
    """
    from ...models.characteristics import characteristics
    from ...models.files import load, plain
    from ...models.gear_sheet import GearSheet, comparison
    from ...models.joint import load_joint

    if out is not None and out.suffix != ".png":
        raise InputError(f"--out {out}: expected a file .png")
    described = load_joint(joint)
    catalogue = load(gear_sheet, GearSheet, "a gear's data sheet") if gear_sheet is not None else None
    found = characteristics(described)
    seen = _seen(described)
    if as_json:
        compared = comparison(described, catalogue) if catalogue is not None else {}
        answer = {"joint": described.name, **plain(found), **compared, "diagnosis": seen}
    else:
        from ...views.joint_text import WIDTH, comparison_text, joint_text

        console().print(joint_text(described, found, seen), width=WIDTH)
        if catalogue is not None:
            console().print(comparison_text(described, catalogue), width=WIDTH)
    if out is not None:
        from ...views.figures.joint import joint_figure
        from ...views.figures.sheet import save

        save(joint_figure(described, found, seen, catalogue), out)
        if not as_json:
            print(out)
    return answer if as_json else None


def _seen(joint: Joint) -> dict[str, list[str]]:
    """Return causes by the channels that a diagnosis needs to detect them."""
    from ...diagnosis.trials.draw import drowned
    from ...models import causes
    from ...models.signals import CHANNELS, POSITIONS

    hidden, usual = drowned(joint), "with both encoders and the motor current"
    found: dict[str, list[str]] = {usual: []}
    for name in causes.of(joint):
        needs = [n for n in causes.get(name).needs if n not in (*POSITIONS, "motor_current")]
        if name in hidden:
            what = "masked by the description's tolerances at ordinary size"
        elif needs:
            what = f"also with {' and '.join(CHANNELS[n].name.replace('_', ' ') for n in needs)}"
        else:
            what = usual
        found.setdefault(what, []).append(name)
    return found
