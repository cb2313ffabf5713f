"""Properties of a joint: stiffness, hysteresis, friction, resonances, resolution, detectable causes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from ...models.characteristics import Characteristics
from ...models.gear_sheet import EFFICIENCY, RUNNING, GearSheet, SheetEntry
from ...models.joint import Joint
from ..joint_text import causes_lines
from ..style import COMMAND, EXTERNAL, MODEL, PARTS, TRUTH
from .sheet import sheet, styled

_BAND = 0.25
_COLUMN = 118  # characters of the last panel's text


@styled
def joint_figure(
    joint: Joint, c: Characteristics, seen: Mapping[str, Sequence[str]], sheet_of_gear: GearSheet | None = None
) -> Figure:
    """Draw a joint by its characteristics `c`, with bands of one standard deviation of the tolerances. `seen`: causes
    by the channels that a diagnosis needs to detect them; `sheet_of_gear`: its running torques and efficiencies are
    drawn, each with the joint's curve at its temperature or speed."""
    rated = joint.numbers["rated_torque"].value
    caption = (
        "Bands and bars: one standard deviation of the description's tolerances. Torsion with the rotor locked; friction "
        f"without load, seen at the output. Rated torque {rated:g} N·m; the motor gives {c.largest_torque:.3g} N·m at its "
        f"current limit and {c.no_load_speed:.3g} rad/s at its supply. {' '.join(joint.description.split())}"
    )
    lines = causes_lines(seen, _COLUMN, "    ")
    figure, rows = sheet(joint.name, caption, [2.3, 2.3, 2.0, 0.16 * len(lines) - 0.2], columns=2, shared=())
    (stiffness, loop), (friction, lowest), (driving, back_driving), (text, empty) = rows
    _stiffness(stiffness, c, rated)
    _loop(loop, c)
    _friction(friction, c)
    _efficiency(driving, "Efficiency of driving", c, c.driving, c.driving_deviation)
    _efficiency(back_driving, "Efficiency of back-driving", c, c.back_driving, c.back_driving_deviation)
    if sheet_of_gear is not None:
        _data_sheet(friction, driving, joint, c, sheet_of_gear)
    driving.legend(loc="lower right")
    if c.resonances:
        _resonances(lowest, c, rated)
    _resolution(stiffness, c)
    for axes in (text, empty):
        axes.set_axis_off()
    text.set_title("Causes that a diagnosis can detect")
    text.text(0, 0.98, "\n".join(lines), va="top", fontsize=8.2, transform=text.transAxes, linespacing=1.35)
    return figure


def _data_sheet(friction: Axes, driving: Axes, joint: Joint, c: Characteristics, sheet_of_gear: GearSheet) -> None:
    p, entries = joint.record()[0], sheet_of_gear.entries()
    colors = {key: f"C{3 + k}" for k, key in enumerate(dict.fromkeys(_kind(one) for one in entries))}
    for key, color in colors.items():
        own = [one for one in entries if _kind(one) == key]
        first = own[0]
        label = f"data sheet, {first.temperature:g} °C"
        if first.kind == RUNNING:
            w = c.speed[c.speed > 0]
            friction.plot(
                [one.speed / p["N"] for one in own], [p["N"] * one.value for one in own], "o", color=color, label=label
            )
            friction.plot(w / p["N"], [p["N"] * first._replace(speed=x).predicted(p) for x in w], "--", color=color)
        elif first.kind == EFFICIENCY:
            label += f", {first.speed / p['N']:.2g} rad/s"
            driving.plot([one.load for one in own], [100 * one.value for one in own], "o", color=color, label=label)
            loads = c.torque[1:]
            driving.plot(loads, [100 * first._replace(load=x).predicted(p) for x in loads], "--", color=color)
    friction.legend()


def _kind(one: SheetEntry) -> tuple[str, float, float]:
    """Return what a curve of a data sheet has in common: kind, temperature, and an efficiency's speed."""
    return one.kind, one.temperature, one.speed if one.kind == EFFICIENCY else 0.0


def _stiffness(axes: Axes, c: Characteristics, rated: float) -> None:
    twist, deviation = 1e3 * c.torsion, 1e3 * c.torsion_deviation
    axes.fill_betweenx(c.torque, twist - deviation, twist + deviation, color=MODEL, alpha=2 * _BAND, lw=0)
    axes.plot(twist, c.torque, color=TRUTH)
    axes.axhline(rated, color=COMMAND, ls="--", lw=0.8)
    axes.set(title="Stiffness", xlabel="torsion [mrad]", ylabel="torque [N·m]", xlim=(0, None), ylim=(0, None))


def _resolution(axes: Axes, c: Characteristics) -> None:
    begin = float(c.stiffness[0])
    words = [
        f"a count: motor {c.counts[0] * begin:.2g} N·m",
        f"link {c.counts[1] * begin:.2g} N·m",
        f"both: {c.noise * begin:.2g} N·m rms",
    ]
    if c.sensor_noise:
        words.append(f"torque sensor: {c.sensor_noise:.2g} N·m rms")
    axes.text(
        0.97, 0.05, "\n".join(words), transform=axes.transAxes, ha="right", va="bottom", fontsize=8, color=COMMAND
    )


def _loop(axes: Axes, c: Characteristics) -> None:
    axes.plot(1e3 * c.loop_torsion, c.loop_torque, color=PARTS["flexspline"])
    half = 1e3 * c.half_width
    axes.plot([-half, half], [0, 0], color=EXTERNAL, lw=2.5, solid_capstyle="butt")
    axes.set(title=f"Hysteresis, ±{half:.2g} mrad at zero torque", xlabel="torsion [mrad]", ylabel="torque [N·m]")


def _friction(axes: Axes, c: Characteristics) -> None:
    moving = c.speed > 0
    speed, friction, deviation = c.output_speed[moving], c.friction[moving], c.friction_deviation[moving]
    axes.fill_between(
        speed, np.maximum(friction - deviation, 0), friction + deviation, color=EXTERNAL, alpha=_BAND, lw=0
    )
    axes.plot(speed, friction, color=EXTERNAL)
    axes.set(title="Friction", xlabel="speed of the joint [rad/s]", ylabel="torque [N·m]", xscale="log", ylim=(0, None))
    axes.set_xlim(speed[0], speed[-1])


def _efficiency(axes: Axes, title: str, c: Characteristics, values: np.ndarray, deviation: np.ndarray) -> None:
    for k, (speed, own, std) in enumerate(zip(c.efficiency_speed, 100 * values, 100 * deviation, strict=True)):
        axes.fill_between(
            c.torque, np.maximum(own - std, 0), np.minimum(own + std, 100), color=f"C{k}", alpha=_BAND, lw=0
        )
        axes.plot(c.torque, own, color=f"C{k}", label=f"{speed:.2g} rad/s")
    axes.set(title=title, xlabel="load [N·m]", ylabel="efficiency [%]", xlim=(0, None), ylim=(0, 100))


def _resonances(axes: Axes, c: Characteristics, rated: float) -> None:
    names = list(dict.fromkeys((r.mounting, r.rotor) for r in c.resonances))
    for r in c.resonances:
        y = len(names) - 1 - names.index((r.mounting, r.rotor)) + (0.12 if r.torque == 0 else -0.12)
        color = PARTS["flexspline"] if r.torque == 0 else PARTS["wave_generator"]
        axes.errorbar(
            r.frequency, y, xerr=min(r.deviation, 0.95 * r.frequency), color=color, marker="o", ms=5, capsize=3
        )
        axes.annotate(
            f"{r.frequency:.3g}", (r.frequency, y), xytext=(0, 5 if r.torque == 0 else -5),
            textcoords="offset points", ha="center", va="bottom" if r.torque == 0 else "top", fontsize=7.5,
        )  # fmt: skip
    axes.set_xscale("log")
    lowest, highest = min(r.frequency for r in c.resonances), max(r.frequency for r in c.resonances)
    axes.set_xlim(0.6 * lowest, 1.7 * highest)
    axes.set_ylim(-0.6, len(names) - 0.3)
    axes.yaxis.set_ticks(range(len(names)), [f"{m}\nrotor {rotor}" for m, rotor in reversed(names)], fontsize=7.5)
    ticks = [f for k in range(-1, 5) for f in (10.0**k, 2 * 10.0**k, 5 * 10.0**k) if 0.6 * lowest < f < 1.7 * highest]
    axes.xaxis.set_ticks(ticks)
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.set(title=f"Resonances at 0 (blue) and {rated:g} N·m", xlabel="frequency [Hz]")
