"""Properties of a joint in a terminal of 80 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from ..models.gear_sheet import comparison
from .tables import heading, narrow_table

if TYPE_CHECKING:
    from ..models.characteristics import Characteristics
    from ..models.gear_sheet import GearSheet
    from ..models.joint import Joint

WIDTH = 80
"""Largest width in columns."""
_SHARES = (0.1, 0.5, 1.0, 2.0)  # of the rated torque


def joint_text(joint: Joint, c: Characteristics, seen: Mapping[str, Sequence[str]]) -> RenderableType:
    """Return a joint for the terminal; arguments as of `figures.joint.joint_figure`."""
    number = {symbol: one.value for symbol, one in joint.numbers.items()}
    first = Text.assemble((joint.name, "bold"), f": ratio {number['N']:g}, rated {number['rated_torque']:g} N·m; ")
    first.append(f"the motor gives {c.largest_torque:.3g} N·m and {c.no_load_speed:.3g} rad/s")
    return Group(
        first, Text("\n".join(textwrap.wrap(" ".join(joint.description.split()), WIDTH)), style="dim"), "",
        _stiffness(c, number["rated_torque"]), Text(_hysteresis(c)), "", _efficiency(c, number["rated_torque"]), "",
        _resonances(c, number["rated_torque"]), Text("\n".join(_encoders(c))), "",
        Text("Causes that a diagnosis can detect", style="bold"), *(_causes(seen)),
    )  # fmt: skip


def comparison_text(joint: Joint, sheet: GearSheet) -> RenderableType:
    """Return the joint's predictions at the entries of its gear's data sheet."""
    found = comparison(joint, sheet)
    table = narrow_table(
        f"Predictions and {sheet.source}",
        f"error: of an efficiency in points, else relative [%]; RMS of the friction {100 * found['residual']:.2g} %",
    )
    for name in ("entry", "at"):
        table.add_column(name)
    for name in ("stated", "predicted", "error"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in found["gear_sheet"]:
        table.add_row(
            Text(row["entry"]), row["at"], f"{row['stated']:.3g}", f"{row['predicted']:.3g}", f"{row['error']:+.1f}"
        )
    return Group(table, *(Text("\n".join(textwrap.wrap(note, WIDTH))) for note in found["notes"]))


def _stiffness(c: Characteristics, rated: float) -> RenderableType:
    table = narrow_table(
        "Stiffness, rotor locked, without friction", "±: one standard deviation of the description's tolerances"
    )
    table.add_column("")
    torques = [share * rated for share in _SHARES]
    for torque in torques:
        table.add_column(heading(f"{torque:.3g}", "N·m"), justify="right")

    def at(values: np.ndarray, scale: float) -> list[float]:
        return [scale * float(np.interp(t, c.torque, values)) for t in torques]

    twist, deviation = at(c.torsion, 1e3), at(c.torsion_deviation, 1e3)
    table.add_row(Text("torsion [mrad]"), *(f"{x:.3g} ± {s:.2g}" for x, s in zip(twist, deviation, strict=True)))
    table.add_row(Text("stiffness [N·m/rad]"), *(f"{float(f'{x:.3g}'):.6g}" for x in at(c.stiffness, 1.0)))
    table.add_row(Text("encoders see [N·m rms]"), *(f"{x:.2g}" for x in at(c.torque_resolution, 1.0)))
    return table


def _efficiency(c: Characteristics, rated: float) -> RenderableType:
    table = narrow_table("Efficiency [%] over load", "±: one standard deviation of the description's tolerances")
    for name in ("load [N·m]", "speed [rad/s]", "driving", "back-driving"):
        table.add_column(name, justify="right")
    for share in _SHARES:
        for k, speed in enumerate(c.efficiency_speed):
            found = [
                100 * np.interp(share * rated, c.torque, values[k])
                for values in (c.driving, c.driving_deviation, c.back_driving, c.back_driving_deviation)
            ]
            words = [f"{found[i]:.0f} ± {found[i + 1]:.0f}" for i in (0, 2)]
            table.add_row(f"{share * rated:.3g}", f"{speed:.2g}", *words)
    return table


def _hysteresis(c: Characteristics) -> str:
    width, deviation = 1e3 * c.half_width, 1e3 * c.half_width_deviation
    return f"hysteresis: ±{width:.2g} mrad (± {deviation:.1g}) at zero torque, rotor locked, loaded slowly"


def _resonances(c: Characteristics, rated: float) -> RenderableType:
    table = narrow_table("Resonances [Hz], undamped", "rotor held: by a stiff position controller; free: without one")
    for name in ("mounting", "rotor"):
        table.add_column(name)
    for torque in (0.0, rated):
        table.add_column(heading(f"at {torque:.3g}", "N·m"), justify="right")
    for mounting in dict.fromkeys(r.mounting for r in c.resonances):
        for rotor in ("held", "free"):
            mine = [r for r in c.resonances if (r.mounting, r.rotor) == (mounting, rotor)]
            cells = [f"{r.frequency:.3g} ± {r.deviation:.2g}" for r in mine]
            table.add_row(Text(mounting), rotor, *cells)
    return table


def _encoders(c: Characteristics) -> list[str]:
    begin = float(c.stiffness[0])
    motor, link = c.counts
    sensor = f"; torque sensor: {c.sensor_noise:.2g} N·m rms" if c.sensor_noise else ""
    text = (
        f"encoders: a count of the motor's is {1e6 * motor:.3g} µrad of torsion or {motor * begin:.2g} N·m, of the link's "
        f"{1e6 * link:.3g} µrad or {link * begin:.2g} N·m; both {c.noise * begin:.2g} N·m rms{sensor}"
    )
    return textwrap.wrap(text, WIDTH)


def _causes(seen: Mapping[str, Sequence[str]]) -> list[Text]:
    found = []
    for what, names in seen.items():
        if names:
            words = ", ".join(name.replace("_", " ") for name in names)
            found.append(Text("\n".join(textwrap.wrap(f"{what}: {words}", WIDTH, subsequent_indent="  "))))
    return found
