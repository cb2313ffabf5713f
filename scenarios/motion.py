"""Motions added to a scenario's waypoints: sine, chirp, multisine, and commands from a file."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..models.controller import Mode
from ..models.errors import InputError, first_line
from ..models.files import Strict

_FADE = 1.0  # s, at most a tenth of the duration: fade in and out of oscillations


class AddedMotion(Strict):
    """A motion added to the waypoints, in their unit: rad, rad/s or N·m.

    Oscillations fade in and out within a tenth of the duration, at most 1 s.
    """

    kind: Literal["sine", "chirp", "multisine", "file"]
    """Shape over time. A chirp's frequency grows exponentially; a multisine has phases with a low peak (Schroeder)."""
    start: Annotated[float, Field(ge=0, description="s")] = 0.0
    duration: Annotated[float | None, Field(gt=0, description="s; of a file: to its last time")] = None
    amplitude: Annotated[float, Field(gt=0)] = 1.0
    """Peak of a sine or chirp, RMS times √2 of a multisine, factor of a file's commands."""
    frequency: Annotated[float | None, Field(gt=0, description="Hz; of chirp and multisine the lowest")] = None
    end_frequency: Annotated[float | None, Field(gt=0, description="Hz, the highest")] = None
    lines: Annotated[int, Field(ge=2, le=2000, description="sines in a multisine, evenly apart in frequency")] = 30
    file: str | None = None
    """CSV or Parquet with columns `time` [s] and `position`, `velocity` or `torque`, as the waypoints have it."""

    @model_validator(mode="after")
    def _complete(self) -> AddedMotion:
        wanted = {"sine": ("duration", "frequency"), "file": ("file",)}.get(
            self.kind, ("duration", "frequency", "end_frequency")
        )
        for name in ("duration", "frequency", "end_frequency", "file"):
            if name in wanted and getattr(self, name) is None:
                raise ValueError(f"{name}: missing, as a {self.kind} needs one")
            if name not in (*wanted, "duration") and getattr(self, name) is not None:
                raise ValueError(f"{name}: a {self.kind} has none")
        if self.frequency is not None and self.end_frequency is not None and self.end_frequency <= self.frequency:
            raise ValueError(f"end_frequency: expected more than {self.frequency:g} Hz, got {self.end_frequency:g} Hz")
        return self

    def in_folder(self, folder: Path) -> AddedMotion:
        """Return the motion with the absolute path of its file, which was relative to a folder."""
        if self.file is None or Path(self.file).is_absolute():
            return self
        return self.model_copy(update={"file": str((folder / self.file).resolve())})

    def signal(self, time: np.ndarray, mode: Mode = "position") -> tuple[np.ndarray, np.ndarray]:
        """Return the command of a mode and its derivative at times [s], shape (n,) each."""
        if self.kind == "file":
            return self._of_file(time, mode)
        T, f, end = (x or 0.0 for x in (self.duration, self.frequency, self.end_frequency))
        t = np.clip(time - self.start, 0.0, T)
        if self.kind == "sine":
            x, dx = np.sin(2 * np.pi * f * t), 2 * np.pi * f * np.cos(2 * np.pi * f * t)
        elif self.kind == "chirp":
            rate = np.log(end / f) / T
            x = np.sin(2 * np.pi * f * np.expm1(rate * t) / rate)
            dx = 2 * np.pi * f * np.exp(rate * t) * np.cos(2 * np.pi * f * np.expm1(rate * t) / rate)
        else:
            w = 2 * np.pi * np.linspace(f, end, self.lines)
            phase = -np.pi * np.arange(self.lines) * np.arange(1, self.lines + 1) / self.lines
            x, dx = np.zeros_like(t), np.zeros_like(t)
            for wk, phi in zip(w, phase, strict=True):  # a loop: all at once would need too much memory
                x, dx = x + np.sin(wk * t + phi), dx + wk * np.cos(wk * t + phi)
            x, dx = x / np.sqrt(self.lines), dx / np.sqrt(self.lines)
        fade = min(_FADE, 0.1 * T)
        u = np.clip(np.minimum(t, T - t) / fade, 0.0, 1.0)
        envelope = 0.5 - 0.5 * np.cos(np.pi * u)
        slope = 0.5 * np.pi / fade * np.sin(np.pi * u) * np.where(t < 0.5 * T, 1.0, -1.0)
        return self.amplitude * envelope * x, self.amplitude * (slope * x + envelope * dx)

    def _of_file(self, time: np.ndarray, mode: Mode) -> tuple[np.ndarray, np.ndarray]:
        at, command, rate = _read(self.file or "", mode)
        t = time - self.start
        if self.duration is not None:
            t = np.minimum(t, self.duration)
        inside = (t >= at[0]) & (t < min(at[-1], self.duration or np.inf))
        x, dx = np.interp(t, at, command), np.where(inside, np.interp(t, at, rate), 0.0)
        return self.amplitude * x, self.amplitude * dx


@lru_cache(maxsize=8)
def _read(file: str, mode: Mode) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a file's times from its first [s], commands and their derivatives."""
    import pandas as pd

    try:
        table = pd.read_parquet(file) if file.endswith(".parquet") else pd.read_csv(file)
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read as a motion: {first_line(error)}") from error
    columns = []
    for name in ("time", mode):
        if name not in table:
            raise InputError(f"{file}: expected a column {name!r}, got {', '.join(map(str, table.columns))}")
        values = pd.to_numeric(table[name], errors="coerce").to_numpy(float)
        if len(values) < 2 or not np.isfinite(values).all():
            raise InputError(f"{file}: column {name!r}: expected two or more finite numbers, got others")
        columns.append(values)
    time, command = columns
    if not np.all(np.diff(time) > 0):
        row = int(np.argmax(np.diff(time) <= 0)) + 2
        raise InputError(f"{file}: column 'time': expected increasing times, got {time[row - 1]:g} s in row {row}")
    return time - time[0], command, np.gradient(command, time)
