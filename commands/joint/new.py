"""`flexspline joint new`: a description from datasheets."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...models.errors import InputError, nearest
from .._console import console
from .._options import AsJson, option

if TYPE_CHECKING:
    from ...models.datasheet import NewJoint
    from ...models.gear_sheet import GearSheet

_ASKED = {
    "gear": ("--gear", "Gear, as series-size-ratio (CSG-25-100)"),
    "Kt": ("--torque-constant", "Motor: torque constant (57 mNm/A)"),
    "R": ("--resistance", "Motor: terminal resistance (1.56 ohm)"),
    "L": ("--inductance", "Motor: terminal inductance (0.6 mH)"),
    "Jm": ("--rotor-inertia", "Motor: rotor inertia (181 gcm²)"),
    "motor_encoder": ("--motor-encoder", "Motor encoder: counts per turn (4096) or bits (12 bit)"),
    "link_encoder": ("--link-encoder", "Link encoder: counts per turn or bits (20 bit)"),
}
"""Values that only a datasheet has: option and question."""

EXAMPLES = (
    'flexspline joint new --gear CSG-14-100 --torque-constant "57 mNm/A" --resistance 1.56 --inductance "0.6 mH"'
    ' --rotor-inertia "181 gcm²" --motor-encoder 4096 --link-encoder "20 bit" --out my_joint.yaml',
)


def command(
    gear: Annotated[str | None, option("Gear as `series-size-ratio`: `CSG-25-100`.")] = None,
    torque_constant: Annotated[str | None, option("Of the motor, Kt: `57 mNm/A`.")] = None,
    resistance: Annotated[str | None, option("Of the motor between its terminals, R: `1.56 ohm`.")] = None,
    inductance: Annotated[str | None, option("Of the motor between its terminals, L: `0.6 mH`.")] = None,
    rotor_inertia: Annotated[str | None, option("Of the motor, Jm: `181 gcm²`.")] = None,
    motor_encoder: Annotated[str | None, option("Counts per turn, `4096`, or bits, `12 bit`.")] = None,
    link_encoder: Annotated[str | None, option("Counts per turn or bits, `20 bit`.")] = None,
    gear_sheet: Annotated[
        Path | None,
        option(
            "The gear's data sheet, .yaml: running and starting torque, efficiency, hysteresis; friction is fitted to it."
        ),
    ] = None,
    motor: Annotated[str, option("Name of the motor, for the sources.")] = "",
    name: Annotated[str, option("Of the joint; by default that of the gear.")] = "",
    description: Annotated[str, option("A sentence for people.")] = "",
    inertia: Annotated[
        float | None, option("Of the payload, about the axis [kg·m²]; by default from the size.", min=0)
    ] = None,
    gravity_moment: Annotated[
        float | None, option("Of the payload, at horizontal [N·m]; by default from the size.", min=0)
    ] = None,
    changes: Annotated[
        list[str] | None,
        option("Any other known number: `current_limit=6 A`, `K1=31000`. Repeatable.", "--set", metavar="SYMBOL=VALUE"),
    ] = None,
    sources: Annotated[
        list[str] | None, option("Where a number is from. Repeatable.", "--source", metavar="SYMBOL=TEXT")
    ] = None,
    tolerances: Annotated[
        list[str] | None,
        option(
            "Relative standard deviation, `Jm=0.3`; above 0.5 a factor: `bw=2` is known within a factor of 3. Repeatable.",
            "--tolerance",
            metavar="SYMBOL=SHARE",
        ),
    ] = None,
    out: Annotated[Path | None, option("File to write; NAME.yaml by default.")] = None,
    force: Annotated[bool, option("Replace existing files.", "--force")] = False,
    as_json: AsJson = False,
) -> Any:
    """Make a joint description from the datasheets of gear, motor and encoders; at a terminal it asks for missing values.

    Numbers without a unit are SI. Other numbers are filled by rules of scale with wide tolerances; the command and the file list
    them with the rule.
    """
    from ...models.datasheet import Datasheet, new_joint, quantity, write_joint
    from ...models.files import load
    from ...models.gear_sheet import GearSheet, comparison
    from ...models.joint_check import check

    answers = {
        "gear": gear, "Kt": torque_constant, "R": resistance, "L": inductance, "Jm": rotor_inertia,
        "motor_encoder": motor_encoder, "link_encoder": link_encoder,
    }  # fmt: skip
    read = _complete(answers)
    series, size, ratio = read.pop("gear")
    encoders = {key: read.pop(key) for key in ("motor_encoder", "link_encoder")}
    numbers = read | {symbol: quantity(text, symbol, f"--set {symbol}") for symbol, text in _pairs("--set", changes)}
    shares = {symbol: _share(symbol, text) for symbol, text in _pairs("--tolerance", tolerances)}
    catalogue = load(gear_sheet, GearSheet, "a gear's data sheet") if gear_sheet is not None else None
    sheet = Datasheet(
        series=series, size=size, ratio=ratio, numbers=numbers, name=name, motor=motor, tolerances=shares, inertia=inertia,
        gravity_moment=gravity_moment, description=description, sources=dict(_pairs("--source", sources)), gear=catalogue,
        **encoders,
    )  # fmt: skip
    if out is not None and out.suffix != ".yaml":
        raise InputError(f"--out {out}: expected a file .yaml")
    made = new_joint(sheet, out)
    for target in (made.path, made.path.parent / made.joint.model):
        if target.exists() and not force:
            raise InputError(f"{target}: expected no such file, --force replaces it")
    path, mjcf = write_joint(made.joint, made.path)
    compared = comparison(made.joint, catalogue) if catalogue is not None else {}
    if as_json:
        return compared | {
            "file": str(path), "mjcf": str(mjcf), "filled": made.filled,
            "problems": check(path).problems,
        }  # fmt: skip
    _show(made, path, mjcf, catalogue)


def _complete(answers: dict[str, str | None]) -> dict[str, Any]:
    """Return the values of `_ASKED`; missing ones are asked for. Raises `InputError`: missing ones without a terminal."""
    read = {key: _read(key, text) for key, text in answers.items() if text is not None}
    missing = [key for key in _ASKED if key not in read]
    if missing and not sys.stdin.isatty():
        options = ", ".join(_ASKED[key][0] for key in missing)
        raise InputError(f"joint new: expected {options}, got none; at a terminal it asks for them")
    for key in missing:
        read[key] = typer.prompt(_ASKED[key][1], value_proc=_asking(key))
    return read


def _read(key: str, text: str) -> Any:
    from ...models.datasheet import encoder, gear_name, quantity

    option = _ASKED[key][0]
    if key == "gear":
        return gear_name(text, option)
    return encoder(text, option) if key.endswith("encoder") else quantity(text, key, option)


def _asking(key: str) -> Callable[[str], Any]:
    def read(text: str) -> Any:
        try:
            return _read(key, text)
        except InputError as error:
            raise typer.BadParameter(str(error)) from error

    return read


def _pairs(option: str, given: Sequence[str] | None) -> Iterator[tuple[str, str]]:
    from ...models.joint_parts import SYMBOLS

    for one in given or ():
        symbol, sign, text = one.partition("=")
        if not sign:
            raise InputError(f"{option} {one}: expected SYMBOL=…, got no '='")
        if symbol not in SYMBOLS:
            raise InputError(
                f"{option} {one}: expected one of {', '.join(SYMBOLS)}, got {symbol!r}{nearest(symbol, SYMBOLS)}"
            )
        yield symbol, text


def _share(symbol: str, text: str) -> float:
    try:
        share = float(text)
    except ValueError:
        share = -1.0
    if not 0 <= share < 10:
        raise InputError(f"--tolerance {symbol}={text}: expected a share from 0 to 10, got {text!r}")
    return share


def _spread(tolerance: float) -> str:
    """Return a tolerance as a percentage, or as a factor if it is wide."""
    from ...models.calibration import NARROW

    if not tolerance:
        return ""
    return f"factor {1 + tolerance:.2g}" if tolerance > NARROW else f"{100 * tolerance:.0f} %"


def _show(made: NewJoint, path: Path, mjcf: Path, catalogue: GearSheet | None) -> None:
    from ...models.joint_check import check
    from ...views.joint_text import comparison_text
    from ...views.tables import text_table
    from .check import line

    terminal = console()
    title = f"{made.joint.name}: filled by rules, not from a datasheet"
    rows = [
        (f.name, f"{f.value:.4g}{'' if f.unit == '1' else f' {f.unit}'}", _spread(f.tolerance), f.rule)
        for f in made.filled
    ]
    heads = ("number", "value", "±", "rule")
    terminal.print(text_table(title, "±: standard deviation, relative or as a factor", heads, rows, (0, 3)))
    if catalogue is not None:
        terminal.print(comparison_text(made.joint, catalogue))
    for problem in check(path).problems:
        terminal.print(line(path, problem), style="yellow", soft_wrap=True)
    terminal.print(f"{path} and {mjcf}")
    terminal.print(
        f"now: flexspline joint show {path}\n     flexspline run link_sweep --set joint={path}", soft_wrap=True
    )
