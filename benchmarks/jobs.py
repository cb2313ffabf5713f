"""Commands that write, each with an earlier output and a new one, and a measurement for them."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flexspline.models.recording import Recording, write_recording


@dataclass(frozen=True)
class Job:
    """A command that writes to a folder.

    Attributes:
      name: of the command. old, new: its words for an earlier output and for a new one.
      repeats: whether it writes the same bytes whenever it is called.
    """

    name: str
    old: list[str]
    new: list[str]
    repeats: bool = True

    def words(self, which: str, out: Path) -> list[str]:
        """The command line that writes one of the two to `out`."""
        return [*(self.old if which == "old" else self.new), "--out", str(out)]


def jobs(folder: Path) -> list[Job]:
    """Commands with two outputs each, of different content under the same names, and their inputs."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, amplitude in (("a", 0.4), ("b", 0.3)):
        write_recording(recording(6.0, amplitude), folder / name)
    log = folder / "log.csv"
    log.write_text("t,qm,ql,i\n" + "\n".join(f"{k / 250},{k / 10},{k / 1000},{k % 7}" for k in range(400)) + "\n")
    columns = "columns: {time: {column: t, unit: s}, motor_position: {column: qm, unit: rad}, "
    columns += "link_position: {column: ql, unit: rad}, motor_current: {column: i, unit: A, scale: SCALE}}\n"
    for name, scale in (("one", "1.0"), ("two", "2.0")):
        head = f"format: 1\nname: {name}\njoint: test-joint\nlink: {{inertia: 0.1, gravity_moment: 1.0}}\n"
        (folder / f"{name}.yaml").write_text(head + columns.replace("SCALE", scale))
    study = (
        "name: small\nseeds: {count: 2}\nscenarios: [no_load]\nset: {duration: 2.0}\nfilters: [EKF]\nmetrics: [rms]\n"
    )
    (folder / "study.yaml").write_text(study)
    run = ["run", "no_load", "--no-figures", "--no-recording", "--set"]
    sweep = ["sweep", str(folder / "study.yaml"), "--no-figures", "--chunk", "1"]
    diagnose = ["diagnose", str(folder / "m"), "--time", "0.1"]
    shutil.copytree(folder / "a", folder / "m")
    return [
        Job("import", *(["import", str(folder / f"{name}.yaml"), str(log), "--force"] for name in ("one", "two"))),
        Job("run", [*run, "duration=2"], [*run, "duration=3"]),
        Job("estimate", *(["estimate", str(folder / "m"), "--filter", name] for name in ("EKF", "model"))),
        Job("sweep", [*sweep, "--seeds", "2"], [*sweep, "--seeds", "4"]),
        Job("diagnose", [*diagnose, "--exact"], diagnose, repeats=False),
    ]


def recording(seconds: float, amplitude: float = 0.4) -> Recording:
    """A smooth motion of the test joint, sampled at 1 kHz."""
    t = np.arange(round(seconds * 1000)) * 1e-3
    q = amplitude * np.sin(t)
    torque = 9.0 * np.sin(q)
    noise = np.random.default_rng(1).normal
    columns = {
        "motor_position": 100 * (q + torque / 8000) + noise(0, 1e-4, len(t)),
        "link_position": q + noise(0, 1e-6, len(t)),
        "motor_current": torque / 11 + 0.3 * np.sign(np.cos(t)) + noise(0, 4e-3, len(t)),
        "joint_torque": torque + noise(0, 0.05, len(t)),
    }
    return Recording("slow", t, columns)


def content(out: Path) -> dict[str, bytes]:
    """Contents of a folder's files, without hidden ones and a person's."""
    return {
        p.relative_to(out).as_posix(): p.read_bytes()
        for p in out.rglob("*")
        if p.is_file() and not any(part.startswith(".") for part in p.relative_to(out).parts) and p.name != "mine.txt"
    }
