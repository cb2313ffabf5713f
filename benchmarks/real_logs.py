"""Logs of real joints: error of the description, a plain regression and a diagnosis on seconds that none of them has seen.

Each log is split in time. Regression and diagnosis get the first part. The error is that of the current or torque in the
last part, sample by sample, in motion (faster than 5 % of the usual largest speed). `python -m benchmarks real_logs`
writes table and figure of docs/real_logs.md. The recordings are not part of this project: `--shared` is their folder.
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd

from flexspline.diagnosis.data.importing import import_recording, load_layout
from flexspline.diagnosis.diagnose import diagnose
from flexspline.diagnosis.regression import MOVING, regressions
from flexspline.diagnosis.validate import validate
from flexspline.models.arm import ArmSpec
from flexspline.models.datasheet import Datasheet, new_joint
from flexspline.models.joint import Joint, load_joint
from flexspline.models.joint_parts import Mounting
from flexspline.models.recording import Measurement, Recording, in_arm
from flexspline.scenarios.evaluation.intervals import Interval

from . import plots

PAGE = Path(__file__).parents[1] / "docs" / "real_logs.md"
TRAINED = 0.6
"""Share of a log that the regression and the diagnosis see."""
PAUSE = 0.2
"""Seconds between the parts."""


@dataclass(frozen=True)
class Log:
    """A real log, cut: joint as its data sheet has it, recordings before and after the cut."""

    name: str
    joint: Joint
    first: tuple[Recording, ...]
    last: tuple[Recording, ...]


@dataclass(frozen=True)
class Outcome:
    """RMS errors of a channel on the last part, in its unit, and what the diagnosis of the first part says."""

    log: str
    channel: str
    unit: str
    described: float
    regression: float
    diagnosed: float
    verdict: str
    causes: str

    @property
    def row(self) -> str:
        """A row of the page's table."""
        ratio = self.diagnosed / self.regression
        return (
            f"| {self.log} | {self.channel.replace('_', ' ')} [{self.unit}] | {self.described:.3g} | {self.regression:.3g} | "
            f"{self.diagnosed:.3g} | {ratio:.2f} | {self.verdict} | {self.causes or '–'} |"
        )


def cut(name: str, joint: Joint, recordings: Sequence[Recording]) -> Log:
    """Cut every recording of a log at the same share of its time."""
    first, last = [], []
    for r in recordings:
        since = (r.time - r.time[0]) / (r.time[-1] - r.time[0])
        first.append(r.at(np.flatnonzero(since < TRAINED)))
        last.append(r.at(np.flatnonzero((r.time - r.time[0]) > TRAINED * (r.time[-1] - r.time[0]) + PAUSE)))
    return Log(name, joint, tuple(first), tuple(last))


# --- logs ------------------------------------------------------------------------------------------------------------


def kinova(shared: Path, folder: Path) -> list[Log]:
    """A Kinova Gen3's second joint: strain wave gear 100:1, 1 kHz, one encoder, current and a torque by the drive's model."""
    case = shared / "cases" / "01_index_for_time_Kinova"
    table = pd.read_csv(case / "joint_2.csv")
    columns = {"link_position": "Position2", "motor_current": "Cur2", "joint_torque": "Torque2"}
    recording = Recording(
        "joint_2",
        1e-3 * table["Time"].to_numpy(),
        {name: table[column].to_numpy() for name, column in columns.items()},
        link=Mounting(inertia=2.2, gravity_moment=38.0, gravity_angle=np.pi),
    )
    return [cut("Kinova Gen3, joint 2", load_joint(str(case / "gen3_large.yaml")), [recording])]


def pendulum(shared: Path, folder: Path) -> list[Log]:
    """An AK80-6 drive with a pendulum: planetary gear 6:1, 300 Hz, counts of 2.9 mrad."""
    case = shared / "cases" / "19_quasi_direct_drive_pendulum_DFKI"
    table = pd.read_csv(case / "pendulum.csv")
    columns = {"motor_position": 6 * table["position"].to_numpy(), "motor_torque": table["torque"].to_numpy() / 6}
    link = Mounting(inertia=0.143, gravity_moment=2.81)
    recording = Recording("pendulum", table["time"].to_numpy(), columns, link=link)
    return [cut("AK80-6 with a pendulum", load_joint(str(case / "ak80_6.yaml")), [recording])]


def double_pendulum(shared: Path, folder: Path) -> list[Log]:
    """Two AK80-6 drives in series (planetary gears 6:1), 500 Hz, torque from the drives' current; both joints move.

    Masses, lengths and inertias are the published ones.
    """
    robot = shared / "robots" / "double_pendulum"
    p = {k: float(v) for k, v in re.findall(r"(\w+): (\S+)", (robot / "published_parameters.yml").read_text())}
    body = ""
    for k in (2, 1):
        centre, mass = p[f"r{k}"], p[f"m{k}"]
        own = max(p[f"I{k}"] - mass * centre**2, 1e-4)
        inertial = f'<inertial pos="0 0 {-centre}" mass="{mass}" diaginertia="{own} {own} 1e-4"/>'
        body = f'<body pos="0 0 {-p["l1"] * (k == 2)}"><joint name="joint{k}" axis="0 -1 0"/>{inertial}{body}</body>'
    model = folder / "double_pendulum.xml"
    model.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>", encoding="utf-8")
    joint = load_joint(str(shared / "cases" / "19_quasi_direct_drive_pendulum_DFKI" / "ak80_6.yaml"))
    found = []
    for k in (1, 2):
        recordings = []
        for file in sorted(robot.glob("*.csv")):
            table = pd.read_csv(file)
            columns = {
                "link_position": table[f"pos_meas{k}"].to_numpy(),
                "motor_torque": table[f"tau_meas{k}"].to_numpy() / p["gr"],
            }
            recording = Recording(file.stem, table["time"].to_numpy(), columns)
            others = {f"arm_joint{3 - k}_position": table[f"pos_meas{3 - k}"].to_numpy()}
            spec = ArmSpec(model=model.name, joint=f"joint{k}")
            recordings.append(in_arm(recording, spec, others, model, folder, folder))
        found.append(cut(f"double pendulum, joint {k}", joint, recordings))
    return found


def friction(shared: Path, folder: Path) -> list[Log]:
    """Motion made with the published friction law of an eRob80 (strain wave gear 100:1), two loads."""
    case = shared / "cases" / "13_friction_of_an_eRob80"
    recordings = []
    for name, inertia, moment in (("light", 0.045, 2.943), ("heavy", 0.36, 17.658)):
        table = pd.read_csv(case / f"{name}.csv")
        columns = {c: table[c].to_numpy() for c in ("link_position", "motor_current")}
        link = Mounting(inertia=inertia, gravity_moment=moment)
        recordings.append(Recording(name, table["time"].to_numpy(), columns, link=link))
    return [cut("eRob80 (published friction)", load_joint(str(case / "erob80.yaml")), recordings)]


SERVO_RESISTANCE = 5.0 / 1.47
"""Resistance between the terminals of an XL330 [Ω], by stall voltage and current of its data sheet."""


def servo(shared: Path, folder: Path) -> list[Log]:
    """An XL330-M288 servo (spur gears 288:1) with a pendulum of known mass: 190 Hz, counts of 1.5 mrad.

    Its PWM over the resistance between the terminals stands for a current. Kt and R are from the stall torque and current of the
    data sheet; inertia and friction are guesses.
    """
    numbers = {
        "N": 288.4, "Kt": 0.52 / 1.47 / 288.4, "R": SERVO_RESISTANCE, "L": 5e-4, "Jm": 1.2e-8, "Jw": 1e-9, "bm": 1e-9, "Fc": 1e-4,
        "bw": 5e-8,
    }  # fmt: skip
    wide = {"Jm": 1.0, "Kt": 0.3, "Fc": 2.0, "bw": 2.0}
    sheet = Datasheet("CSG", 14, 100, numbers, {"counts": 4096}, {"bits": 12}, name="xl330", tolerances=wide)
    joint = new_joint(sheet, folder / "xl330.yaml").joint
    return [cut("XL330 servo with a pendulum", joint, servo_recordings(shared))]


def servo_recordings(shared: Path) -> list[Recording]:
    """Read the XL330's logs: position, PWM as a current, and the pendulum."""
    recordings = []
    for file in sorted((shared / "robots" / "xl330").glob("*.json")):
        log = json.loads(file.read_text())
        time, position, load, volts = (
            np.array([entry[name] for entry in log["entries"]], float)
            for name in ("timestamp", "position", "load", "input_volts")
        )
        current = np.where(load > 2**15, load - 2**16, load) / 1000 * volts / SERVO_RESISTANCE
        link = Mounting(
            inertia=log["mass"] * log["length"] ** 2 + 5e-4, gravity_moment=log["mass"] * 9.81 * log["length"]
        )
        columns = {"link_position": position, "motor_current": current}
        recordings.append(Recording(file.stem, time - time[0], columns, link=link))
    return recordings


def ur3e(shared: Path, folder: Path) -> list[Log]:
    """The shoulder of a UR3e: strain wave gear 101:1, 125 Hz, one encoder."""
    recording = import_recording(load_layout("ur3e"), shared / "ur3e" / "shoulder_first_half.csv")
    return [cut("UR3e, shoulder", load_joint("ur3e-shoulder"), [recording])]


TIAGO = {1: (20, 0.136), 2: (20, 0.136), 3: (17, -0.087), 4: (17, -0.087)}
"""Size of the gear and published torque constant [N·m/A] of TIAGo's first joints; it is negative where the current's sign is."""


def tiago(shared: Path, folder: Path) -> list[Log]:
    """Joints 1 to 4 of a TIAGo: strain wave gears 100:1, 100 Hz, one encoder each; all joints move."""
    robot = shared / "robots" / "tiago"
    position, effort = (pd.read_csv(robot / f"{name}.csv") for name in ("position", "effort"))
    model = folder / "tiago.xml"
    model.write_text(_mjcf(robot / "tiago.urdf"), encoding="utf-8")
    found = []
    for k, (size, constant) in TIAGO.items():
        sheet = Datasheet(
            "CSG", size, 100, {"Kt": abs(constant), "R": 0.5, "L": 5e-4, "Jm": 1e-4 if size == 20 else 4e-5},
            {"counts": 4096}, {"bits": 16}, name=f"tiago-{k}", tolerances={"Jm": 1.0},
        )  # fmt: skip
        joint = new_joint(sheet, folder / f"tiago_{k}.yaml").joint
        columns = {
            "link_position": position[f"- arm_{k}_joint_position"].to_numpy(),
            "motor_current": np.sign(constant) * effort[f"- arm_{k}_joint_effort"].to_numpy(),
        }
        others = {
            f"arm_{name}_position": position[f"- {name}_position"].to_numpy()
            for name in ("torso_lift_joint", *(f"arm_{i}_joint" for i in range(1, 8) if i != k))
        }
        recording = Recording(f"joint_{k}", position["t"].to_numpy(), columns)
        carried = in_arm(recording, ArmSpec(model=model.name, joint=f"arm_{k}_joint"), others, model, folder, folder)
        found.append(cut(f"TIAGo, joint {k}", joint, [carried]))
    return found


def _mjcf(urdf: Path) -> str:
    """An arm's URDF without its looks, and without the inertias that no body has."""
    root = ElementTree.parse(urdf).getroot()
    for link in root.findall("link"):
        for look in (*link.findall("visual"), *link.findall("collision")):
            link.remove(look)
        inertial = link.find("inertial")
        if inertial is not None and float(inertial.find("mass").get("value")) < 0.05:  # type: ignore[union-attr, arg-type]
            link.remove(inertial)
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    spec.compiler.balanceinertia = True
    spec.compile()
    return spec.to_xml()


FRANKA = """
0 0 0.333; 1 0 0 0; 4.970684; 0.003875 0.002081 -0.04762; 0.70337 0.70661 0.009117 -0.000139 0.006772 0.019169
0 0 0; 1 -1 0 0; 0.646926; -0.003141 -0.02872 0.003495; 0.007962 0.02811 0.025995 -0.003925 0.010254 0.000704
0 -0.316 0; 1 1 0 0; 3.228604; 0.027518 0.039252 -0.066502; 0.037242 0.036155 0.01083 -0.004761 -0.011396 -0.012805
0.0825 0 0; 1 1 0 0; 3.587895; -0.05317 0.104419 0.027454; 0.025853 0.019552 0.028323 0.007796 -0.001332 0.008641
-0.0825 0.384 0; 1 -1 0 0; 1.225946; -0.011953 0.041065 -0.038437; 0.035549 0.029474 0.008627 -0.002117 -0.004037 0.000229
0 0 0; 1 1 0 0; 1.666555; 0.060149 -0.014117 -0.010517; 0.001964 0.004354 0.005433 0.000109 -0.001158 0.000341
0.088 0 0; 1 1 0 0; 0.735522; 0.010517 -0.004252 0.061597; 0.012516 0.010027 0.004815 -0.000428 -0.001196 -0.000741
"""
"""Links of a Franka Panda, one a line: position and quaternion in the previous one, mass, centre of mass, inertia as in MJCF
(Gaz et al., *Dynamic Identification of the Franka Emika Panda Robot*, 2019)."""


def franka(shared: Path, folder: Path) -> list[Log]:
    """Return the seven joints of a Franka Panda: strain wave gears, 1 kHz, an encoder and a torque sensor at the link each."""
    robot = shared / "robots" / "franka"
    positions, torques = (np.loadtxt(robot / f"{name}.txt").reshape(-1, 7) for name in ("positions", "torques"))
    time = np.loadtxt(robot / "time.txt")
    body = ""
    links = [line.split("; ") for line in FRANKA.split("\n")[1:-1]]
    for k, (place, turn, mass, centre, inertia) in reversed(list(enumerate(links, 1))):
        inertial = f'<inertial pos="{centre}" mass="{mass}" fullinertia="{inertia}"/>'
        body = f'<body pos="{place}" quat="{turn}"><joint name="joint{k}" axis="0 0 1"/>{inertial}{body}</body>'
    model = folder / "franka.xml"
    model.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>", encoding="utf-8")
    found = []
    for k in range(1, 8):
        sheet = Datasheet(
            "CSG", 25 if k < 5 else 17, 100, {"Kt": 0.1, "R": 0.5, "L": 5e-4, "Jm": 1e-4}, {"counts": 1 << 14}, {"bits": 19},
            name=f"franka-{k}", tolerances={"Jm": 1.0},
        )  # fmt: skip
        joint = new_joint(sheet, folder / f"franka_{k}.yaml").joint
        columns = {"link_position": positions[:, k - 1], "joint_torque": torques[:, k - 1]}
        others = {f"arm_joint{i}_position": positions[:, i - 1] for i in range(1, 8) if i != k}
        recording = Recording(f"joint_{k}", time, columns)
        carried = in_arm(recording, ArmSpec(model=model.name, joint=f"joint{k}"), others, model, folder, folder)
        found.append(cut(f"Franka Panda, joint {k}", joint, [carried]))
    return found


LOGS: tuple[Callable[[Path, Path], list[Log]], ...] = (
    kinova, pendulum, double_pendulum, friction, servo, ur3e, tiago, franka,
)  # fmt: skip


# --- outcomes --------------------------------------------------------------------------------------------------------


def outcomes(log: Log) -> list[Outcome]:
    """What description, regression and diagnosis predict of a log's last part."""
    first, last = (Measurement(log.name, Path(log.name), part) for part in (log.first, log.last))
    said = regressions(first, log.joint)
    diagnosis = diagnose(first, log.joint)
    validations = [validate(last, joint) for joint in (log.joint, diagnosis.extended)]
    causes = ", ".join(f"{c.name.replace('_', ' ')} {c.confidence:.2f}" for c in diagnosis.causes)
    found = []
    for one in said:
        if one.channel not in validations[0].recordings[0].simulated:
            continue
        errors: list[list[np.ndarray]] = [[], [], []]
        for i, r in enumerate(last.recordings):
            moving = _moving(r)
            simulated = [v.recordings[i].simulated[one.channel] for v in validations]
            predicted = [simulated[0], one.predict(r, log.joint), simulated[1]]
            left = (r[one.channel] - np.array(predicted))[:, moving]
            for error, x in zip(errors, left[:, np.isfinite(left).all(axis=0)], strict=True):
                error.append(x)
        described, regression, diagnosed = (float(np.sqrt(np.mean(np.concatenate(e) ** 2))) for e in errors)
        found.append(
            Outcome(
                log.name, one.channel, one.unit, described, regression, diagnosed, diagnosis.verdict, causes
            )
        )  # fmt: skip
    return found


def _moving(recording: Recording) -> np.ndarray:
    position = "link_position" if "link_position" in recording else "motor_position"
    width = max(round(0.1 / recording.interval), 1)
    speed = np.abs(np.gradient(np.convolve(recording[position], np.ones(width) / width, "same"), recording.time))
    inside = (recording.time > recording.time[0] + PAUSE) & (recording.time < recording.time[-1] - PAUSE)
    return inside & (speed > MOVING * np.quantile(speed[inside], 0.98))


def figure(rows: Sequence[str], path: Path) -> None:
    """Draw the errors of description and diagnosis over the regression's, from rows of the table."""
    points: list[plots.Point] = []
    for cells in ([cell.strip() for cell in row.strip("| ").split("|")] for row in rows):
        described, regression, diagnosed = map(float, cells[2:5])
        for name, value in (("description", described / regression), ("diagnosis", diagnosed / regression)):
            points.append((f"{cells[0]}: {cells[1].partition(' [')[0]}", name, Interval(value, value, value, 1)))
    plots.intervals(path, {"": points}, "RMS error / regression's")


def main(words: Sequence[str] = ()) -> None:
    """Print the table, and write it into the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks real_logs", description=__doc__)
    parser.add_argument("--shared", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument(
        "--logs", nargs="*", default=[one.__name__ for one in LOGS], help="some of the logs; the page stays"
    )
    arguments = parser.parse_args(words)
    head = "| log | channel | description | regression | diagnosis | diagnosis / regression | verdict | causes (confidence) |"
    rows = [head, "|---|---|---:|---:|---:|---:|---|---|"]
    print("\n".join(rows))
    with tempfile.TemporaryDirectory() as folder:
        for one in LOGS:
            if one.__name__ in arguments.logs:
                for log in one(arguments.shared, Path(folder)):
                    for outcome in outcomes(log):
                        rows.append(outcome.row)
                        print(outcome.row, flush=True)
    if len(arguments.logs) == len(LOGS):
        text = PAGE.read_text(encoding="utf-8")
        table = "<!-- begin real logs -->\n" + "\n".join(rows) + "\n<!-- end real logs -->"
        PAGE.write_text(
            re.sub("<!-- begin real logs -->.*<!-- end real logs -->", table, text, flags=re.S), encoding="utf-8"
        )
        figure(rows[2:], PAGE.parent / "figures" / "real_logs.png")
