"""Properties of a joint in a terminal of 80 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from ..models.characteristics import Characteristics
from ..models.gear_sheet import GearSheet, comparison
from ..models.joint import Joint
from .report import plain
from .tables import heading, text_table

WIDTH = 80  # largest width in columns
_TOLERANCES = "±: one standard deviation of the description's tolerances"
_SHARES = (0.1, 0.5, 1.0, 2.0)  # of the rated torque


def joint_text(joint: Joint, c: Characteristics, seen: Mapping[str, Sequence[str]]) -> RenderableType:
    """Return a joint for the terminal; arguments as of `figures.joint.joint_figure`."""
    number = {symbol: one.value for symbol, one in joint.numbers.items()}
    first = Text.assemble((joint.name, "bold"), f": ratio {number['N']:g}, rated {number['rated_torque']:g} N·m; ")
    first.append(f"the motor gives {c.largest_torque:.3g} N·m and {c.no_load_speed:.3g} rad/s")
    width, deviation = 1e3 * c.half_width, 1e3 * c.half_width_deviation
    loop = f"hysteresis: ±{width:.2g} mrad (± {deviation:.1g}) at zero torque, rotor locked, loaded slowly"
    return Group(
        first, Text("\n".join(textwrap.wrap(" ".join(joint.description.split()), WIDTH)), style="dim"), "",
        _stiffness(c, number["rated_torque"]), Text(loop), "", _efficiency(c, number["rated_torque"]), "",
        _resonances(c, number["rated_torque"]), Text("\n".join(_encoders(c))), "",
        Text("Causes that a diagnosis can detect", style="bold"), Text("\n".join(causes_lines(seen, WIDTH, "  "))),
    )  # fmt: skip


def comparison_text(joint: Joint, sheet: GearSheet) -> RenderableType:
    """Return the joint's predictions at the entries of its gear's data sheet."""
    found = comparison(joint, sheet)
    caption = (
        f"error: of an efficiency in points, else relative [%]; RMS of the friction {100 * found['residual']:.2g} %"
    )
    rows = [
        (row["entry"], row["at"], f"{row['stated']:.3g}", f"{row['predicted']:.3g}", f"{row['error']:+.1f}")
        for row in found["gear_sheet"]
    ]
    heads = ("entry", "at", "stated", "predicted", "error")
    table = text_table(f"Predictions and {sheet.source}", caption, heads, rows, (0, 1))
    return Group(table, *(Text("\n".join(textwrap.wrap(note, WIDTH))) for note in found["notes"]))


def _stiffness(c: Characteristics, rated: float) -> RenderableType:
    torques = [share * rated for share in _SHARES]

    def at(values: np.ndarray, scale: float) -> list[float]:
        return [scale * float(np.interp(t, c.torque, values)) for t in torques]

    twist, deviation = at(c.torsion, 1e3), at(c.torsion_deviation, 1e3)
    rows = (
        ("torsion [mrad]", *(f"{x:.3g} ± {s:.2g}" for x, s in zip(twist, deviation, strict=True))),
        ("stiffness [N·m/rad]", *(f"{float(f'{x:.3g}'):.6g}" for x in at(c.stiffness, 1.0))),
        ("encoders see [N·m rms]", *(f"{x:.2g}" for x in at(c.torque_resolution, 1.0))),
    )
    heads = [Text(), *(heading(f"{torque:.3g}", "N·m") for torque in torques)]
    return text_table("Stiffness, rotor locked, without friction", _TOLERANCES, heads, rows)


def _efficiency(c: Characteristics, rated: float) -> RenderableType:
    rows = []
    for share in _SHARES:
        for k, speed in enumerate(c.efficiency_speed):
            found = [
                100 * np.interp(share * rated, c.torque, values[k])
                for values in (c.driving, c.driving_deviation, c.back_driving, c.back_driving_deviation)
            ]
            words = [f"{found[i]:.0f} ± {found[i + 1]:.0f}" for i in (0, 2)]
            rows.append((f"{share * rated:.3g}", f"{speed:.2g}", *words))
    heads = map(Text, ("load [N·m]", "speed [rad/s]", "driving", "back-driving"))
    return text_table("Efficiency [%] over load", _TOLERANCES, heads, rows, ())


def _resonances(c: Characteristics, rated: float) -> RenderableType:
    rows = []
    for mounting in dict.fromkeys(r.mounting for r in c.resonances):
        for rotor in ("held", "free"):
            mine = [r for r in c.resonances if (r.mounting, r.rotor) == (mounting, rotor)]
            cells = [f"{r.frequency:.3g} ± {r.deviation:.2g}" for r in mine]
            rows.append((mounting, rotor, *cells))
    heads = [Text("mounting"), Text("rotor"), *(heading(f"at {torque:.3g}", "N·m") for torque in (0.0, rated))]
    caption = "rotor held: by a stiff position controller; free: without one"
    return text_table("Resonances [Hz], undamped", caption, heads, rows, (0, 1))


def _encoders(c: Characteristics) -> list[str]:
    begin = float(c.stiffness[0])
    motor, link = c.counts
    sensor = f"; torque sensor: {c.sensor_noise:.2g} N·m rms" if c.sensor_noise else ""
    text = (
        f"encoders: a count of the motor's is {1e6 * motor:.3g} µrad of torsion or {motor * begin:.2g} N·m, of the link's "
        f"{1e6 * link:.3g} µrad or {link * begin:.2g} N·m; both {c.noise * begin:.2g} N·m rms{sensor}"
    )
    return textwrap.wrap(text, WIDTH)


def causes_lines(seen: Mapping[str, Sequence[str]], width: int, indent: str) -> list[str]:
    """Return the causes that each set of channels can show, wrapped; `indent`: of further lines."""
    texts = (f"{what}: {', '.join(map(plain, names))}" for what, names in seen.items() if names)
    return [line for text in texts for line in textwrap.wrap(text, width, subsequent_indent=indent)]
