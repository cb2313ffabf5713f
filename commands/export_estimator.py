"""`flexspline export-estimator`: an estimator for a robot's controller, as C."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from ..models.errors import InputError
from ._console import console
from ._options import argument, option, with_plugins

EXAMPLES = (
    "flexspline export-estimator augmented --joint my_joint.yaml --to c",
    "flexspline export-estimator RAREKF --joint test-joint --to c --interval 0.0005 --out rarekf.h",
)


@with_plugins
def command(
    name: Annotated[str, argument("Name of a causal estimator (`flexspline estimators`).")],
    joint: Annotated[str, option("A joint description, or the name of a shipped one.")],
    to: Annotated[str, option("Language: c, which is C99.")] = "c",
    mounting: Annotated[str | None, option("Mounting of the joint; by default the joint's.")] = None,
    interval: Annotated[float, option("Time between samples [s].")] = 1e-3,
    out: Annotated[Path | None, option("Header to write; by default NAME.h.")] = None,
) -> None:
    """Write an estimator with a joint's numbers as one C99 header: `init` and `step`, no allocation.

    The header is generated from the code of this package. It depends on the C mathematics library (`-lm`) only.
    """
    from ..estimator import registry
    from ..estimator.estimator import CausalEstimator, KnownJoint
    from ..estimator.export_c import header
    from ..models.files import write_text
    from ..models.joint import load_joint

    if to != "c":
        raise InputError(f"--to {to}: expected c")
    if not 1e-6 <= interval <= 1.0:
        raise InputError(f"--interval {interval:g}: expected a time between samples from 1e-6 to 1 s")
    described = load_joint(joint)
    known = KnownJoint.of(described, described.mount(mounting))
    estimator = registry.get(name).scaled(known, interval)
    if not isinstance(estimator, CausalEstimator):
        raise InputError(f"estimator {name!r}: expected a causal estimator, got a smoother")
    text = header(estimator, known, interval)
    path = Path(f"{name.lower()}.h") if out is None else out
    write_text(path, text)
    console().print(f"{path}")
