"""Simulation of an arm: the closed loops of its joints in one plant, then every joint's filters over its signals."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ...estimator.estimator import KnownJoint
from ...models.arm import ArmRecord, ArmSpec, pickups
from ...models.arm_dynamics import Arm, external_torques
from ...models.errors import InputWarning
from ...models.files import yaml_text
from ...models.joint_parts import Mounting
from ...models.output import output_folder
from ...models.parameters import neutral
from ...sim import arm as plant
from ...sim.arm import ArmJoint
from ...sim.loop import Change, ClosedLoop
from ..experiment import Experiment, estimate, signals_of
from ..run import Place, Run, run_of
from ..run_folder import View, save_run
from ..scenario import Scenario
from .arm_scenario import ArmScenario

_MJCF = "arm.xml"


def run_arm(
    scenario: ArmScenario, folder: Path | None = None, threads: int = 1, records: Mapping[str, np.ndarray] | None = None
) -> dict[str, Run]:
    """Run a scenario of an arm; return a run of every joint by its name, from the base to the tip.

    Estimators know the payload of a joint with the others at the median of their commands. The effect of the others'
    motion is external torque for them. The recordings include it: the arm's links and the other encoders' angles.

    `folder`: of the scenario's file, to which paths of joints and model are relative; `threads`: filters at a time, the
    result does not depend on it; `records`: parameters of other plants, such as with hidden effects, by the joint's name,
    shape (1,) each. Raises as `run.run_scenario`. Warns of actuators, damping or friction of the model's driven hinges,
    which are not used (`InputWarning`).
    """
    alone = {joint.name: Experiment.of(joint, folder) for joint in scenario.arm}
    alone = {name: replace(e, record=(records or {}).get(name, e.record)) for name, e in alone.items()}
    names, both, unused = list(alone), list(zip(scenario.arm, alone.values(), strict=True)), ""
    joints = [ArmJoint(one.name, e.joint, e.record, one.length, one.turn) for one, e in both]
    if scenario.model is None:
        bolted = [one.mount(e.known_joint) for one, e in both]
        mjcf = plant.rigid([replace(one, record=_links(load)) for one, load in zip(joints, bolted, strict=True)])
        build = partial(plant.build, joints, scenario.timestep, payloads=scenario.payloads)
    else:
        mjcf, unused = scenario.masses(folder)
        build = partial(plant.on_hinges, mjcf, joints, scenario.timestep, scenario.payloads)
    middle = {
        name: float(np.median(e.command)) if e.scenario.mode == "position" else e.start for name, e in alone.items()
    }
    experiments = []
    for name, e in alone.items():
        others = {other: angle for other, angle in middle.items() if other != name}
        link = Arm(ArmSpec(model=_MJCF, joint=name), mjcf).mounting(others)
        own = _alone(scenario, e.scenario).model_copy(update={"link": link, "mounting": ""})
        described = KnownJoint.of(e.known_joint, link)
        experiments.append(replace(e, scenario=own, known=described))
    times = pickups(scenario.payloads, experiments[0].scenario.time)
    changes = [Change(tick, build(carried=carried)) for tick, carried in times]
    driven = [e.driven(prefix=one.prefix) for e, one in zip(experiments, joints, strict=True)]
    loop = ClosedLoop(build(carried=[False] * len(scenario.payloads)), driven, changes)
    loop.advance(len(experiments[0].command))
    for i, e in enumerate(experiments):
        e.check(loop, place=i)
    done = [e.completed(found) for e, found in zip(experiments, loop.simulations, strict=True)]
    angles = {name: np.ascontiguousarray(s.readings["link_position"]) for name, s in zip(names, done, strict=True)}
    true_angles = np.stack([s.truth["link_position"] for s in done], axis=1)
    pushes = external_torques(mjcf, names, true_angles, np.stack([e.external_torque for e in experiments], axis=1))
    runs = {}
    for i, (name, e, s) in enumerate(zip(names, experiments, done, strict=True)):
        others_angles = {other: angle for other, angle in angles.items() if other != name}
        spec = ArmSpec(model=_MJCF, joint=name, payloads=tuple(scenario.payloads) if scenario.known_payloads else ())
        place = Place(ArmRecord(spec, mjcf, others_angles), pushes[:, i].copy())
        signals = signals_of(s)
        link, load = Arm(place.arm.spec, mjcf).of(
            signals.time, angles[name], others_angles, (slice(0, len(signals.time)),)
        )
        estimators = e.scenario.estimators()
        looped = {filter_: estimators.pop(filter_) for filter_ in [e.scenario.feedback] if filter_ in estimators}
        found = estimate(looped, signals, e.known, threads)  # what the drive had: without the others' load
        if load is not None:
            signals = signals.with_columns(arm_torque=load.on(link.inertia))
        found |= estimate(estimators, signals, e.known, threads)
        runs[name] = run_of(e, s, {entry.name: found[entry.name] for entry in e.scenario.filters}, place)
    if unused:
        warnings.warn(unused, InputWarning, stacklevel=2)
    return runs


def _links(mounting: Mounting) -> np.ndarray:
    """Return a record, shape (1,), with the link of a mounting only."""
    record = neutral()
    p = record[0]
    p["Jl"], p["Mg"], p["gravity_angle"] = mounting.inertia, mounting.gravity_moment, mounting.gravity_angle
    return record


def _alone(scenario: ArmScenario, joint: Scenario) -> Scenario:
    """Return the scenario of a single joint."""
    data = {name: getattr(joint, name) for name in Scenario.model_fields}
    text = (
        f"{joint.name} of the arm {scenario.name}, with the others at the median of their commands. {joint.description}"
    )
    data |= {
        "name": f"{scenario.name}_{joint.name}",
        "description": text.strip(),
        "known_payloads": scenario.known_payloads,
    }
    return Scenario.model_construct(**data)


def save_arm(
    scenario: ArmScenario, runs: dict[str, Run], out: Path, views: Sequence[View] = (), within: Path | None = None
) -> list[Path]:
    """Write the runs of an arm's joints: a run folder each, and `arm.yaml`, to run it again, with its model's masses.

    Args, Raises: as `run_folder.save_run`.
    """
    folders = [save_run(run, out / name, views, within) for name, run in runs.items()]
    data = scenario.written()
    for joint in data["arm"]:
        joint["joint"], joint["known_joint"] = f"{joint['name']}/joint.yaml", f"{joint['name']}/known_joint.yaml"
        joint["plant"], joint["sensors"] = {}, {}
    place = next(iter(runs.values())).place
    with output_folder(out, "arm", writes=("arm.yaml", _MJCF)) as folder:
        if scenario.model is not None and place is not None:
            data["model"], data["positions"] = _MJCF, {}
            (folder / _MJCF).write_text(place.arm.mjcf, encoding="utf-8")
        (folder / "arm.yaml").write_text(yaml_text(data), encoding="utf-8")
    return folders
