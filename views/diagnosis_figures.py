"""Figures of a diagnosis, drawn as SVG: measured against simulated, residuals against what they may depend on.

SVG by hand keeps the report self-contained, small and sharp, and draws in milliseconds.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from .series import envelope

MEASURED, BEFORE, AFTER = "#59636E", "#E0533D", "#00875F"
"""Measured; simulated by the calibrated joint; by the extended joint."""
FORWARD, BACKWARD = "#2F7FD1", "#B8579A"
"""Directions of motion."""
NOISE, HELD_OUT, GRID, TEXT, FAINT = "#DDE6EE", "#F3EBD8", "#E6E9ED", "#2B3138", "#77818C"
POINTS = 700
_CLIPS = itertools.count()


@dataclass
class Axes:
    """One panel with axes in data units; everything drawn is clipped to it.

    Attributes:
      x, y: limits of the data.
      title, xlabel, ylabel: what is shown, with units.
      accent: whether the panel is framed as the telling one.
      width, height: [px].
    """

    x: tuple[float, float]
    y: tuple[float, float]
    title: str = ""
    xlabel: str = ""
    ylabel: str = ""
    accent: bool = False
    width: int = 276
    height: int = 176
    xticks: Sequence[tuple[float, str]] | None = None
    _parts: list[str] = field(default_factory=list)

    left, right, top, bottom = 44, 8, 20, 32

    def px(self, x) -> np.ndarray:
        """Data to pixels, horizontally."""
        low, high = self.x
        return self.left + (np.asarray(x, float) - low) / (high - low) * (self.width - self.left - self.right)

    def py(self, y) -> np.ndarray:
        """Data to pixels, vertically."""
        low, high = self.y
        inner = self.height - self.top - self.bottom
        return np.clip(self.top + (high - np.asarray(y, float)) / (high - low) * inner, -2000, 4000)

    def line(self, x, y, color: str, width: float = 1.2, dash: str = "", opacity: float = 1.0) -> None:
        """A line; values that are not finite leave gaps."""
        x, y = np.asarray(x, float), np.asarray(y, float)
        good = np.isfinite(x) & np.isfinite(y)
        pieces, pen = [], "M"
        for a, b, ok in zip(self.px(x), self.py(y), good, strict=True):
            if not ok:
                pen = "M"
                continue
            pieces.append(f"{pen}{a:.1f} {b:.1f}")
            pen = "L"
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(
            f'<path d="{"".join(pieces)}" fill="none" stroke="{color}" stroke-width="{width}" opacity="{opacity}"{dashed}/>'
        )

    def dots(self, x, y, color: str, radius: float = 1.0, opacity: float = 0.3) -> None:
        """Dots, as one path of zero-length strokes."""
        d = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(self.px(x), self.py(y), strict=True))
        self._parts.append(
            f'<path d="{d}" stroke="{color}" stroke-width="{2 * radius}" stroke-linecap="round" opacity="{opacity}"/>'
        )

    def band(self, low: float, high: float, color: str = NOISE) -> None:
        """A horizontal band over the whole width."""
        a, b = float(self.py(high)), float(self.py(low))
        inner = self.width - self.left - self.right
        self._parts.append(
            f'<rect x="{self.left}" y="{a:.1f}" width="{inner}" height="{max(b - a, 0.5):.1f}" fill="{color}"/>'
        )

    def stripes(self, edges: Sequence[tuple[float, float]], color: str = HELD_OUT) -> None:
        """Vertical stripes from x to x."""
        y, h = self.top, self.height - self.top - self.bottom
        for begin, end in edges:
            a, b = float(self.px(begin)), float(self.px(end))
            self._parts.append(f'<rect x="{a:.1f}" y="{y}" width="{b - a:.1f}" height="{h}" fill="{color}"/>')

    def bars(self, x, y, width: float, color: str) -> None:
        """Bars from zero, `width` in data units."""
        zero = float(self.py(0.0))
        for a, b in zip(np.atleast_1d(x), np.atleast_1d(y), strict=True):
            left, w, top = (
                float(self.px(a - width / 2)),
                float(self.px(a + width / 2) - self.px(a - width / 2)),
                float(self.py(b)),
            )
            self._parts.append(
                f'<rect x="{left:.1f}" y="{min(top, zero):.1f}" width="{w:.1f}" height="{abs(zero - top):.1f}" fill="{color}"/>'
            )

    def svg(self) -> str:
        """The panel."""
        w, h = self.width, self.height
        name = f"clip{next(_CLIPS)}"
        inner_w, inner_h = w - self.left - self.right, h - self.top - self.bottom
        out = [f'<svg viewBox="0 0 {w} {h}" width="{w}" height="{h}" role="img" aria-label="{escape(self.title)}">']
        if self.accent:
            out.append(
                f'<rect x="1" y="1" width="{w - 2}" height="{h - 2}" rx="5" fill="#FFF9EC" stroke="#E8A100" stroke-width="2"/>'
            )
        out.append(
            f'<clipPath id="{name}"><rect x="{self.left}" y="{self.top}" width="{inner_w}" height="{inner_h}"/></clipPath>'
        )
        ticks = self.xticks or [(t, _label(t)) for t in _ticks(*self.x, max(inner_w // 45, 3))]
        grid, labels = [], []
        for t in _ticks(*self.y, max(inner_h // 22, 3)):
            y = float(self.py(t))
            grid.append(f'<path d="M{self.left} {y:.1f}h{inner_w}" stroke="{GRID}"/>')
            labels.append(f'<text x="{self.left - 4}" y="{y + 3:.1f}" text-anchor="end" class="t">{_label(t)}</text>')
        for t, text in ticks:
            x = float(self.px(t))
            labels.append(
                f'<text x="{x:.1f}" y="{h - self.bottom + 12}" text-anchor="middle" class="t">{escape(text)}</text>'
            )
        out += [f'<g clip-path="url(#{name})">', *grid, *self._parts, "</g>"]
        out.append(
            f'<rect x="{self.left}" y="{self.top}" width="{inner_w}" height="{inner_h}" fill="none" stroke="#C9CFD6"/>'
        )
        out += labels
        out.append(f'<text x="{self.left}" y="13" class="h">{escape(self.title)}</text>')
        out.append(
            f'<text x="{self.left + inner_w / 2}" y="{h - 5}" text-anchor="middle" class="l">{escape(self.xlabel)}</text>'
        )
        if self.ylabel:
            y = self.top + inner_h / 2
            out.append(
                f'<text transform="translate(9 {y}) rotate(-90)" text-anchor="middle" class="l">{escape(self.ylabel)}</text>'
            )
        return "".join([*out, "</svg>"])


def _ticks(low: float, high: float, count: int) -> np.ndarray:
    raw = (high - low) / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(s * power for s in (1, 2, 2.5, 5, 10) if s * power >= raw * 0.999)
    return np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1) * step


def _label(value: float) -> str:
    text = f"{value:.4g}" if abs(value) > 1e-12 else "0"
    return text.replace("-", "−").replace("e−0", "e−")


def legend(entries: Sequence[tuple[str, str]]) -> str:
    """A legend in HTML: colour, text."""
    return (
        '<p class="legend">'
        + "".join(f'<span><i style="background:{color}"></i>{escape(text)}</span>' for color, text in entries)
        + "</p>"
    )


def limits(values: np.ndarray, share: float = 0.5, margin: float = 0.08, least: float = 0.0) -> tuple[float, float]:
    """Limits that hold all but `share` percent of the values at either end."""
    values = values[np.isfinite(values)]
    if not len(values):
        return -1.0, 1.0
    low, high = np.percentile(values, [share, 100 - share])
    low, high = min(low, -least), max(high, least)
    pad = margin * (high - low) or 1.0
    return float(low - pad), float(high + pad)


# --- measured against simulated --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Overlay:
    """One channel of one recording.

    Attributes:
      name: of the recording; channel, unit.
      time: [s], shape (k,).
      measured: shape (k,), or None where only the residual means something.
      before, after: residuals, shape (k,); not finite where they do not count.
      noise: of the residual, rms.
      held_out: stretches of time that no fit saw.
    """

    name: str
    channel: str
    unit: str
    time: np.ndarray
    measured: np.ndarray | None
    before: np.ndarray
    after: np.ndarray
    noise: float
    held_out: Sequence[tuple[float, float]]


def overlay(o: Overlay, y: tuple[float, float], width: int = 370) -> str:
    """Values (where there are any) above residuals, on the same time axis."""
    x = (float(o.time[0]), float(o.time[-1]))
    parts = []
    if o.measured is not None:
        values = Axes(x, limits(o.measured, 0.05), f"{o.name}: {o.channel}", "", o.unit, width=width, height=160)
        i = envelope(o.measured, POINTS // 2)
        values.line(o.time[i], o.measured[i], MEASURED, 2.2, opacity=0.55)
        values.line(o.time[i], (o.measured - o.before)[i], BEFORE, 1.1)
        values.line(o.time[i], (o.measured - o.after)[i], AFTER, 1.1)
        parts.append(values.svg())
    title = "measured − simulated" if o.measured is not None else f"{o.name}: {o.channel}"
    residual = Axes(x, y, title, "time [s]", o.unit, width=width, height=140)
    residual.stripes(o.held_out)
    residual.band(-2 * o.noise, 2 * o.noise)
    for values, color in ((o.before, BEFORE), (o.after, AFTER)):
        i = envelope(np.nan_to_num(values), POINTS // 2)
        residual.line(o.time[i], values[i], color, 0.9, opacity=0.85)
    parts.append(residual.svg())
    return f'<div class="stack">{"".join(parts)}</div>'


# --- a residual against what it may depend on --------------------------------------------------------------------------


@dataclass(frozen=True)
class Balance:
    """A torque balance's residual with what it may depend on, all recordings joined; k samples that count.

    Attributes:
      name: for people; unit.
      before, after: shape (k,).
      noise: rms.
      time, link, motor, velocity, load: [s] since the recording's start, [rad], [rad, motor side], [rad/s, motor side], [N·m].
      rising: whether the load rises.
    """

    name: str
    unit: str
    before: np.ndarray
    after: np.ndarray
    noise: float
    time: np.ndarray
    link: np.ndarray
    motor: np.ndarray
    velocity: np.ndarray
    load: np.ndarray
    rising: np.ndarray

    def variable(self, key: str) -> np.ndarray:
        """Values of a variable, shape (k,)."""
        return {
            "time": self.time, "link": self.link, "turn": np.mod(self.motor, 2 * np.pi), "velocity": self.velocity,
            "load": self.load, "loading": self.load, "direction": np.sign(self.velocity),
        }[key]  # fmt: skip


VARIABLES = {
    "time": "time since the start [s]",
    "link": "link angle [rad]",
    "turn": "motor angle in one turn [rad]",
    "velocity": "motor velocity [rad/s]",
    "load": "load [N·m]",
    "loading": "load, rising or falling [N·m]",
    "direction": "direction of motion",
}
BINS = 36
ORDERS = np.arange(0.5, 14.01, 0.5)


def _bins(b: Balance, key: str) -> np.ndarray:
    """Bin of every sample, shape (k,): of the variable, and for angle and load of the direction too."""
    x = b.variable(key)
    if key == "direction":
        return (x > 0).astype(int)
    low, high = (0.0, 2 * np.pi) if key == "turn" else np.percentile(x, [0.2, 99.8])
    i = np.clip(((x - low) / max(high - low, 1e-12) * BINS).astype(int), 0, BINS - 1)
    sides = _sides(b, key)
    return 2 * i + sides[0][2] if key in ("link", "load", "loading") else i


def _sides(b: Balance, key: str) -> tuple[tuple[str, str, np.ndarray], ...]:
    """What the two lines of a panel are: name, colour, which samples."""
    if key == "loading":
        return ("rising", FORWARD, b.rising), ("falling", BACKWARD, ~b.rising)
    return ("forward", FORWARD, b.velocity > 0), ("backward", BACKWARD, b.velocity <= 0)


def explained(b: Balance, residual: np.ndarray, key: str) -> float:
    """Share of a residual's mean square that its mean in bins of a variable explains, 0 … 1, less what chance does."""
    bins = _bins(b, key)
    count = np.bincount(bins)
    total = np.bincount(bins, residual)
    used = count > 20
    power = float(np.sum(total[used] ** 2 / count[used])) / max(float(np.sum(residual**2)), 1e-30)
    chance = 8.0 * used.sum() / max(len(residual), 1)  # neighbouring samples are alike
    return float(np.clip((power - chance) / max(1 - chance, 1e-9), 0.0, 1.0))


def telling(balances: Sequence[Balance]) -> tuple[Balance, str, float] | None:
    """The balance and variable that give most of the discrepancy away, with the share explained; None without any.

    In terms of what exceeds the noise: a variable that explains everything of a balance that is quiet gives nothing away.
    """
    best, found = 0.3, None
    for b in balances:
        excess = float(np.mean(b.before**2)) / max(b.noise**2, 1e-30)
        for key in VARIABLES:
            share = explained(b, b.before, key)
            worth = share * excess
            if worth > best:
                best, found = worth, (b, key, share)
    return found


def _means(x, r, low, high, bins=BINS):
    """Centres of bins, mean of r in each (NaN where there is hardly anything)."""
    i = np.clip(((x - low) / (high - low) * bins).astype(int), 0, bins - 1)
    count = np.bincount(i, minlength=bins)
    mean = np.bincount(i, r, minlength=bins) / np.maximum(count, 1)
    return low + (np.arange(bins) + 0.5) / bins * (high - low), np.where(count > 8, mean, np.nan)


def orders(motor: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Amplitude of the residual at each of `ORDERS` per turn of the motor, shape (len(ORDERS),), by least squares."""
    angle = motor[:, None] * ORDERS
    X = np.concatenate([np.cos(angle), np.sin(angle), np.ones((len(motor), 1))], axis=1)
    G = X.T @ X
    c = np.linalg.solve(G + 1e-9 * np.trace(G) / len(G) * np.eye(len(G)), X.T @ residual)
    return np.hypot(c[: len(ORDERS)], c[len(ORDERS) : 2 * len(ORDERS)])


def balance(b: Balance, accent: str | None) -> str:
    """Panels of a balance's residual against everything that it may depend on."""
    y = limits(np.concatenate([b.before, b.after]), 0.3, 0.1, 2.5 * b.noise)
    rng = np.random.default_rng(0)
    some = rng.choice(len(b.before), min(600, len(b.before)), replace=False)
    panels = []
    for key, label in VARIABLES.items():
        if key == "direction":
            panels.append(_direction(b, y, accent == key))
            continue
        x = b.variable(key)
        low, high = (0.0, 2 * np.pi) if key == "turn" else np.percentile(x, [0.2, 99.8])
        high = max(high, low + 1e-9)
        shares = explained(b, b.before, key), explained(b, b.after, key)
        axes = Axes((low, high), y, _explains(shares), label, b.unit, accent == key)
        axes.band(-2 * b.noise, 2 * b.noise)
        axes.dots(x[some], b.before[some], MEASURED, 0.9, 0.22)
        for _, color, side in _sides(b, key):
            if side.sum() > 50:
                axes.line(*_means(x[side], b.before[side], low, high), color, 1.8)
        axes.line(*_means(x, b.after, low, high), AFTER, 1.8)
        panels.append(axes.svg())
    panels.insert(3, _orders(b))
    return f'<div class="grid">{"".join(panels)}</div>'


def _explains(shares: tuple[float, float]) -> str:
    before, after = (f"{100 * s:.0f}" for s in shares)
    return f"explains {before} %, then {after} %"


def _orders(b: Balance) -> str:
    moving = np.flatnonzero(np.abs(b.velocity) > 2.0)[:: max(len(b.velocity) // 6000, 1)]
    if len(moving) < 200:
        return Axes((0, 14), (0, 1), "the motor hardly turns", "order per turn of the motor", b.unit).svg()
    before, after = (orders(b.motor[moving], r[moving]) for r in (b.before, b.after))
    axes = Axes(
        (0, 14.5),
        (0.0, 1.1 * max(float(before.max()), float(after.max()), b.noise)),
        "orders",
        "order per turn of the motor",
        b.unit,
    )
    axes.bars(ORDERS - 0.1, before, 0.2, BEFORE)
    axes.bars(ORDERS + 0.1, after, 0.2, AFTER)
    return axes.svg()


def _direction(b: Balance, y: tuple[float, float], accent: bool) -> str:
    shares = explained(b, b.before, "direction"), explained(b, b.after, "direction")
    axes = Axes(
        (-1.2, 1.2),
        y,
        _explains(shares),
        "direction of motion",
        b.unit,
        accent,
        xticks=[(-0.6, "backward"), (0.6, "forward")],
    )
    axes.band(-2 * b.noise, 2 * b.noise)
    for x, side in ((-0.6, b.velocity < 0), (0.6, b.velocity > 0)):
        for offset, r, color in ((-0.16, b.before, BEFORE), (0.16, b.after, AFTER)):
            if side.sum() > 50:
                low, high = np.percentile(r[side], [16, 84])
                axes.line([x + offset] * 2, [low, high], color, 5, opacity=0.35)
                axes.dots([x + offset], [float(np.mean(r[side]))], color, 4, 1.0)
    return axes.svg()


def torque_trace(name: str, time: np.ndarray, sensor: np.ndarray, before: np.ndarray, after: np.ndarray) -> str:
    """The filter's estimate before and after against the sensor: the error, N·m, of one recording."""
    x = (float(time[0]), float(time[-1]))
    errors = [before - sensor, after - sensor]
    values = Axes(x, limits(sensor, 0.05), f"{name}: joint torque", "", "N·m", width=552, height=150)
    i = envelope(sensor, POINTS // 2)
    values.line(time[i], sensor[i], MEASURED, 2.2, opacity=0.55)
    values.line(time[i], before[i], BEFORE, 1.0)
    values.line(time[i], after[i], AFTER, 1.0)
    axes = Axes(
        x, limits(np.concatenate(errors), 0.3, 0.1), "estimate − sensor", "time [s]", "N·m", width=552, height=130
    )
    for r, color in zip(errors, (BEFORE, AFTER), strict=True):
        smooth = r[np.isfinite(r)]
        if len(smooth) != len(r):
            continue
        j = envelope(r, POINTS // 2)
        axes.line(time[j], r[j], color, 0.9, opacity=0.85)
    return f'<div class="stack">{values.svg()}{axes.svg()}</div>'
