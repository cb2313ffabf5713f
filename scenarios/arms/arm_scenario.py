"""Scenarios of an arm: YAML files that describe the motion of several joints, in series or on hinges of a model."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import mujoco
import numpy as np
from pydantic import Field, GetJsonSchemaHandler, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from ...models.arm import ArmPayload
from ...models.arm_dynamics import put_payloads, reduced
from ...models.errors import InputError, nearest
from ...models.files import Strict, parse
from ...models.joint import Joint
from ...sim.loop import CONTROL_PERIOD
from ...sim.plant import TIMESTEP
from ..scenario import Scenario, parse_changed, put_all, read_scenario

_SHARED = ("duration", "timestep")
_COMMON = (*_SHARED, "seed", "format")  # keys next to `arm`, for all joints
_OF_THE_MODEL = ("mounting", "link", "length", "turn")  # keys of a joint that a model of the arm replaces


class JointInArm(Scenario):
    """A joint of an arm: a scenario without the common keys. A disturbance is a torque on its link."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    """Name in the arm (with `model`: of its hinge), of its folder, and of the column of its angle in the others' recordings."""
    length: Annotated[float, Field(gt=0, le=10, description="from its axis to the next axis, m")] = 0.4
    turn: Annotated[float, Field(ge=-math.pi, le=math.pi)] = 0.0
    """Turn of its axis about the link before it, relative to the axis before, rad."""

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Return the schema without the common keys."""
        schema = handler(core_schema)
        own = handler.resolve_ref_schema(schema)
        for key in _COMMON:
            own["properties"].pop(key, None)
        own["required"] = [key for key in own["required"] if key not in _COMMON]
        return schema

    @model_validator(mode="after")
    def _in_an_arm(self) -> JointInArm:
        if self.locked_rotor:
            raise ValueError("locked_rotor: expected a joint that can move, got one whose rotor is held")
        if self.payloads:
            raise ValueError(
                "payloads: expected them next to `arm`, with the body that carries them, got them in a joint"
            )
        for i, one in enumerate(self.disturbances):
            if one.lever != 0.0:
                raise ValueError(
                    f"disturbances.{i}.lever: expected 0, a pure torque (a force would also load the joints before it), "
                    f"got {one.lever:g} m"
                )
        return self


class ArmScenario(Strict):
    """An experiment with joints in series, from the base to the tip, that with all angles zero points straight down; or with
    joints on hinges of a model."""

    format: Literal[1] = 1
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    """Name of the folder with the joints' runs."""
    description: str = ""
    """Purpose."""
    duration: Annotated[float, Field(gt=0, le=3600, description="s")]
    timestep: Annotated[float, Field(ge=1e-6, le=CONTROL_PERIOD, description="s")] = TIMESTEP
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Of every random stream; joints have different streams."""
    model: str | None = None
    """MJCF or URDF of the arm, relative to the scenario's file: masses, axes and gravity. Without it, links are in series."""
    positions: dict[str, float] = {}
    """Positions [rad], [m] at which other joints of the model are held; by default where the model has them."""
    arm: Annotated[list[JointInArm], Field(min_length=1, max_length=64)]
    """Joints, from the base to the tip; with a model, those of its hinges that have a drive, in any order."""
    payloads: list[ArmPayload] = []
    """Masses that the arm picks up and puts down."""
    known_payloads: bool = True
    """Whether the estimators and the recordings know the payloads."""

    @model_validator(mode="before")
    @classmethod
    def _shared(cls, given: Any) -> Any:
        """Give every joint the common keys and its seed."""
        if not isinstance(given, dict) or not isinstance(given.get("arm"), list):
            return given
        joints = []
        for i, one in enumerate(given["arm"]):
            if not isinstance(one, dict):
                return given
            for key in _COMMON:
                if key in one:
                    raise ValueError(f"arm.{i}.{key}: expected it next to `arm`, for all joints, got it in one of them")
            shared = {key: given[key] for key in _SHARED if key in given}
            seed = given.get("seed", 1)
            if isinstance(seed, int) and seed >= 0:
                entropy = [seed, zlib.crc32(str(one.get("name", "")).encode())]
                shared["seed"] = int(np.random.SeedSequence(entropy).generate_state(1)[0])
            pushes = one.get("disturbances")
            if isinstance(pushes, list):
                shared["disturbances"] = [{"lever": 0.0} | d if isinstance(d, dict) else d for d in pushes]
            joints.append(one | shared)
        return given | {"arm": joints}

    @model_validator(mode="after")
    def _named_once(self) -> ArmScenario:
        names = [joint.name for joint in self.arm]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise ValueError(f"arm.{i}.name: expected another name, got {name!r} again")
        for i, joint in enumerate(self.arm) if self.payloads and self.known_payloads else ():
            if joint.feedback not in ("none", "sensor"):
                raise ValueError(
                    f"known_payloads: expected false, as the filter that is fed back, {joint.feedback} of arm.{i}, does not know "
                    "them in the loop"
                )
        for i, one in enumerate(self.payloads):
            if one.start >= self.duration:
                raise ValueError(
                    f"payloads.{i}.start: expected a time before the end at {self.duration:g} s, got {one.start:g} s"
                )
            if self.model is None and one.body not in names:
                raise ValueError(
                    f"payloads.{i}.body: expected a joint, one of {names}, got {one.body!r}{nearest(one.body, names)}"
                )
        if self.model is None and self.positions:
            raise ValueError("positions: expected them with model, got none")
        for i, joint in enumerate(self.arm) if self.model is not None else ():
            for key in joint.model_fields_set.intersection(_OF_THE_MODEL):
                raise ValueError(f"arm.{i}.{key}: expected none with model, which has the links, got one")
        return self

    def with_joints(self, joints: Mapping[str, Joint]) -> ArmScenario:
        """Return the scenario with `Joint` objects in place of names or paths: `arm.0.joint`, `arm.1.known_joint`."""
        arm = list(self.arm)
        for key, one in joints.items():
            _, place, name = key.split(".")
            arm[int(place)] = arm[int(place)].with_joints({name: one})
        return self.model_copy(update={"arm": arm})

    def in_folder(self, folder: Path) -> ArmScenario:
        """Return the scenario with absolute paths of its motions' files, which were relative to a folder."""
        return self.model_copy(update={"arm": [joint.in_folder(folder) for joint in self.arm]})

    def written(self, stated: bool = False) -> dict[str, Any]:
        """Return plain data, as in a file, with the common keys once; `stated`: without defaults."""
        data = self.model_dump(mode="json", exclude_none=True, exclude_unset=stated)
        for joint in data["arm"]:
            for key in (*_COMMON, *(_OF_THE_MODEL if self.model is not None else ())):
                joint.pop(key, None)
        return data

    def masses(self, folder: Path | None) -> tuple[str, str]:
        """Return the masses and the hinges of its joints as an MJCF's text, from its model, and a line about what of
        the model's drives is not used. Raises `InputError`: as `arm_dynamics.reduced`; positions commanded beyond a
        hinge's range."""
        where, names = f"scenario {self.name}", [joint.name for joint in self.arm]
        path = (folder or Path()) / str(self.model)
        if not path.is_file():
            raise InputError(f"{where}: model: expected an MJCF or URDF file, no such file {str(path)!r}")
        text, ranges, replaced = reduced(path, names, self.positions, where)
        put_payloads(mujoco.MjSpec.from_string(text), self.payloads, f"{where}: ")
        for i, (joint, (low, high)) in enumerate(zip(self.arm, ranges, strict=True)):
            if joint.mode == "position":
                least, most = (float(of(joint.commands()[0])) for of in (np.min, np.max))
                if least < low or most > high:
                    raise InputError(
                        f"{where}: arm.{i}.trajectory: expected positions of {joint.name} from {low:g} to {high:g} rad, its "
                        f"range in {path}, got {least:g} to {most:g} rad"
                    )
        unused = (
            f"{path}: {', '.join(replaced)}: not used, as the joints of `arm` have their own motors, gears and friction"
        )
        return text, unused if replaced else ""


def load_any(
    source: str | Path, changes: list[str] | None = None, seed: int | None = None
) -> tuple[Scenario | ArmScenario, Path]:
    """Load a scenario of a joint or, with the key `arm:`, of an arm, as `scenario.load_scenario`, and return it with
    its file. Keys of an arm's joints are `arm.0.joint`, counted from the base. Raises `InputError`: an unknown or wrong
    scenario."""
    data, path = read_scenario(source, changes, seed)
    model: type[Scenario | ArmScenario] = ArmScenario if "arm" in data else Scenario
    return parse_changed(data, model, path, changes).in_folder(path.parent), path


def load_arm(
    source: str | Path, seed: int | None = None, changes: Mapping[str, Any] | None = None
) -> tuple[ArmScenario, Path]:
    """Load a scenario of an arm, with other values of dotted keys. Raises `InputError`: an unknown or wrong scenario,
    or that of a single joint."""
    data, path = read_scenario(source, None, seed)
    put_all(data, changes or {}, str(path))
    if "arm" not in data:
        raise InputError(f"{path}: arm: expected a scenario of an arm, got that of a single joint")
    return parse(data, ArmScenario, str(path) if changes else path).in_folder(path.parent), path.parent


def changed_arm(scenario: ArmScenario, changes: Mapping[str, Any], seed: int | None = None) -> ArmScenario:
    """Return a scenario of an arm with other values of dotted keys, and another seed if given. Raises `InputError`: an
    unknown key or a wrong value."""
    where = f"scenario {scenario.name}"
    data = scenario.written(stated=True) | ({} if seed is None else {"seed": seed})
    put_all(data, changes, where)
    given_joints = {f"arm.{i}.{key}": one for i, j in enumerate(scenario.arm) for key, one in j.given_joints.items()}
    return parse(data, ArmScenario, where).with_joints({k: one for k, one in given_joints.items() if k not in changes})
