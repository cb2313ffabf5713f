"""A chart as SVG paths, and those of a frequency response. Colours are classes of the page's style sheet, light and dark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..series import envelope

if TYPE_CHECKING:
    from ...diagnosis.bode import Response

WIDTH = 540  # of a chart of which a page shows two in a row [px]
_FREQUENCIES = (0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200)  # ticks [Hz]


@dataclass(frozen=True)
class Mark:
    """A path with its classes of the style sheet."""

    d: str
    kind: str


@dataclass(frozen=True)
class Tick:
    """A position on an axis [px] and its label."""

    at: float
    text: str


@dataclass
class Chart:
    """Axes in data units with marks, which the template clips to the axes."""

    x: tuple[float, float]  # limits of the data
    y: tuple[float, float]  # the same
    title: str = ""  # texts, with units
    xlabel: str = ""  # texts, with units
    ylabel: str = ""  # texts, with units
    accent: bool = False  # whether the chart is framed
    labels: Sequence[tuple[float, str]] = ()  # positions and texts of the ticks below, instead of numbers
    # width, height: of the whole chart [px]; it is scaled on the page
    width: int = 320
    height: int = 186
    marks: list[Mark] = field(default_factory=list)  # drawn so far

    left, right, top, bottom = 54, 6, 22, 34

    @property
    def inner(self) -> tuple[int, int]:
        """Width and height between the axes [px]."""
        return self.width - self.left - self.right, self.height - self.top - self.bottom

    @property
    def xticks(self) -> list[Tick]:
        """Ticks below, from the axes' left end [px]."""
        places = self.labels or [(t, _label(t)) for t in ticks(*self.x, max(self.inner[0] // 52, 3))]
        return [Tick(float(self._px(t)), text) for t, text in places]

    @property
    def yticks(self) -> list[Tick]:
        """Ticks at the left, from the axes' upper end [px]."""
        return [Tick(float(self._py(t)), _label(t)) for t in ticks(*self.y, max(self.inner[1] // 24, 3))]

    def line(self, x: np.ndarray, y: np.ndarray, kind: str) -> None:
        """Draw a line through points, shape (k,) each, as their envelope; values that are not finite are gaps."""
        x, y = np.asarray(x, float), np.asarray(y, float)
        chosen = envelope(y, self.inner[0])
        pieces, joined = [], False
        for a, b, drawn in zip(self._px(x[chosen]), self._py(y[chosen]), np.isfinite(y[chosen]), strict=True):
            if drawn:  # a point alone is a dot
                pieces.append(f"L{a:.1f} {b:.1f}" if joined else f"M{a:.1f} {b:.1f}h0")
            joined = drawn
        self.marks.append(Mark("".join(pieces), f"line {kind}"))

    def lines(self, x: np.ndarray, curves: Mapping[str, np.ndarray]) -> Chart:
        """Draw several lines by their classes of the style sheet, the last on top; return the chart."""
        for kind, y in curves.items():
            self.line(x, y, kind)
        return self

    def dots(self, x: np.ndarray, y: np.ndarray, kind: str) -> None:
        """Draw dots at points, shape (k,) each."""
        d = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(self._px(x), self._py(y), strict=True))
        self.marks.append(Mark(d, f"dots {kind}"))

    def band(self, low: float, high: float, kind: str) -> None:
        """Draw a horizontal band over the whole width."""
        self.boxes([(self.x[0], self.x[1], low, high)], kind)

    def between(self, x: np.ndarray, low: np.ndarray, high: np.ndarray, kind: str) -> None:
        """Draw a band along a line, shape (k,) each, from lowest to highest value in every column of pixels."""
        edges = np.linspace(*self.x, self.inner[0] // 2 + 1)
        column = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
        bottom, top = np.full(len(edges) - 1, np.inf), np.full(len(edges) - 1, -np.inf)
        there = np.isfinite(low) & np.isfinite(high)
        np.minimum.at(bottom, column[there], low[there])
        np.maximum.at(top, column[there], high[there])
        drawn = np.flatnonzero(np.isfinite(bottom))
        self.boxes([(edges[k], edges[k + 1], bottom[k], top[k]) for k in drawn], kind)

    def stripes(self, edges: Sequence[tuple[float, float]], kind: str) -> None:
        """Draw vertical stripes over the whole height, from x to x."""
        self.boxes([(a, b, *self.y) for a, b in edges], kind)

    def boxes(self, corners: Sequence[tuple[float, float, float, float]], kind: str) -> None:
        """Draw filled boxes, each from x to x and from y to y."""
        d = []
        for a, b, low, high in corners:
            (left, right), (bottom, top) = self._px([a, b]), self._py([low, high])
            d.append(f"M{left:.1f} {top:.1f}H{right:.1f}V{bottom:.1f}H{left:.1f}z")
        self.marks.append(Mark("".join(d), f"area {kind}"))

    def _px(self, x: ArrayLike) -> np.ndarray:
        low, high = self.x
        return (np.asarray(x, float) - low) / (high - low) * self.inner[0]

    def _py(self, y: ArrayLike) -> np.ndarray:
        low, high = self.y
        return np.clip((high - np.asarray(y, float)) / (high - low) * self.inner[1], -2000, 4000)


def ticks(low: float, high: float, count: int) -> np.ndarray:
    """Return about `count` round numbers within limits."""
    raw = (high - low) / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(s * power for s in (1, 2, 2.5, 5, 10) if s * power >= raw * 0.999)
    return np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1) * step


def _label(value: float) -> str:
    return (f"{value:.4g}" if abs(value) > 1e-12 else "0").replace("-", "−").replace("e−0", "e−")


def limits(values: np.ndarray, share: float = 0.5, margin: float = 0.08, least: float = 0.0) -> tuple[float, float]:
    """Return limits of the finite values without `share` percent at either end, and at least ± `least`."""
    values = values[np.isfinite(values)]
    if not len(values):
        return -1.0, 1.0
    low, high = np.percentile(values, [share, 100 - share])
    low, high = min(low, -least), max(high, least)
    pad = margin * (high - low) if high > low else 1.0
    return float(low - pad), float(high + pad)


def response_context(found: Response | None) -> dict[str, Any] | None:
    """Return charts and resonances of a frequency response for the template; None without a response."""
    if found is None:
        return None
    f = np.log10(found.frequency)
    x = float(f[0]), float(f[-1])
    labels = tuple((float(np.log10(v)), f"{v:g}") for v in _FREQUENCIES if x[0] <= np.log10(v) <= x[1])
    curves = {"measured broad": found.measured, "after": found.simulated}
    good = np.where(found.coherent, 1.0, np.nan)
    size = {kind: good * 20 * np.log10(np.abs(values)) for kind, values in curves.items()}
    phase = {kind: good * np.degrees(np.angle(values)) for kind, values in curves.items()}
    y = limits(np.concatenate([*size.values()]), 0.0)
    magnitude = Chart(x, y, "magnitude", "frequency [Hz]", "dB of 1 rad/(s·A)", labels=labels, width=WIDTH, height=220)
    angle = Chart(x, (-200.0, 200.0), "phase", "frequency [Hz]", "°", labels=labels, width=WIDTH, height=150)
    coherence = Chart(x, (0.0, 1.05), "coherence", "frequency [Hz]", "1", labels=labels, width=WIDTH, height=150)
    for chart, of in ((magnitude, size), (angle, phase), (coherence, {"measured broad": found.coherence})):
        chart.lines(f, of)
    peaks, dips = found.resonances()
    return {"charts": [[magnitude], [angle, coherence]], "peaks": peaks, "dips": dips}
